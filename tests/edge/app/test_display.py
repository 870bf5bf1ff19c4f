"""edge/app/display.py: what a person sees of a tick."""

import io
from collections.abc import Iterator
from dataclasses import replace

import pytest
from loop_rig import LoopRig

from edge.app.display import LineDisplay, chart_rows, forecast_facts, make_display, page, tick_line
from edge.app.outlet import Outlet
from edge.core.messages import (
    Change,
    Command,
    Decision,
    Echo,
    Event,
    Forecast,
    ForecastSkill,
    ReadingQuality,
    Severity,
    TickRecord,
)
from edge.formats.tick_json import tick_json


@pytest.fixture
def rig() -> Iterator[LoopRig]:
    rig = LoopRig()
    yield rig
    rig.close()


def line(record: TickRecord) -> str:
    return tick_line(tick_json(record))


def test_a_line_tells_all_that_matters(rig: LoopRig) -> None:
    shown = line(rig.tick())
    for words in ("air  22.0 degC", "ref 24.0", "heater 0.50", "fan off", "MPC", "safety -"):
        assert words in shown


def test_on_a_narrow_terminal_a_tick_is_shortened_and_folded(rig: LoopRig) -> None:
    event = Event(
        "k", Severity.INFO, "a long event that goes on and on until it is folded at the edge", 1.0, 1.0
    )
    record = replace(rig.tick(), events=(event,))
    for columns in (80, 40):
        shown = tick_line(tick_json(record), columns)
        assert max(map(len, shown.splitlines())) <= columns
        assert "forecast" not in shown and "folded at" in " ".join(shown.split())
    assert tick_line(tick_json(record), 500) == line(record)
    assert len(tick_line(tick_json(replace(record, events=())), 80).splitlines()) == 1


def test_a_reading_without_a_number_shows_its_quality_and_no_number(rig: LoopRig) -> None:
    rig.board.temp_air, rig.board.quality = None, ReadingQuality.FAULT
    shown = line(rig.tick())
    assert "air (fault)" in shown
    assert "reading.not_good" not in shown  # events are told in words
    assert "the air temperature is not good" in shown


def test_what_safety_changed_is_named(rig: LoopRig) -> None:
    rig.chosen.command = Command(heater_duty=7.0)
    assert "safety heater." in line(rig.tick())


def test_lines_come_out_one_per_tick(rig: LoopRig) -> None:
    text = io.StringIO()
    out = Outlet(text)
    display = make_display(out)
    assert isinstance(display, LineDisplay)  # a StringIO is no terminal
    display.write(rig.tick())
    display.write(rig.tick())
    display.close()
    out.finish()
    assert len(text.getvalue().splitlines()) == 2


def test_the_chart_has_its_rows_whatever_the_numbers(rig: LoopRig) -> None:
    record = rig.tick()
    hot = replace(record, decision=Decision(Command(), "x", forecast=(90.0, float("nan"), -5.0)))
    for records in ([record], [record, hot], [hot] * 200):
        rows = chart_rows(records, 14, 80)
        assert len(rows) == 14
        assert len({len(row) for row in rows}) == 1
        assert any("o" in row for row in rows)


def test_a_chart_without_any_number_says_so(rig: LoopRig) -> None:
    record = rig.tick()
    nothing = replace(
        record, estimate=replace(record.estimate, temp_air=float("nan")), reference_c=float("nan")
    )
    assert chart_rows([nothing], 14, 80) == ["no air temperature yet"]


def test_each_models_forecast_is_shown_where_there_is_one(rig: LoopRig) -> None:
    there = Forecast({1: 22.0, 15: 24.26}, {15: 0.4}, outside=True)
    record = replace(rig.tick(), forecasts={"arx": there, "lstm": Forecast(reason="too few rows")})
    assert "in 15 min arx 24.3  safety" in line(record)
    skill = ForecastSkill("arx", "1", 15, 9, 0.123, None, None, None, None)
    facts = dict(forecast_facts(replace(record, skill=(skill,))))
    assert facts == {"arx in 15 min": "24.3 ± 0.40 (90 %) °C, off by 0.12 K lately, untrained there"}


def full_page(rig: LoopRig) -> tuple[list[TickRecord], list[Event]]:
    """Everything that a page may have to show, and more than fits."""
    there = Forecast({15: 24.26}, {15: 0.4})
    why = {"rule": "heats below the reference " * 9, "cost_tracking": 1.0, "cost": 2.0, "model": "arx"}
    record = replace(
        rig.tick(),
        link_up=False,
        echo=Echo(0.0, False, 0.0, False, True, "over-temperature", 0.0),
        changes=(Change("heater.slew", "heater_duty", 1.0, 0.5, "the heater rises slowly"),),
        decision=Decision(Command(), "MPC-Twin-P", forecast=(24.0, 25.0), why=why),
        forecasts=dict.fromkeys(("arx", "pbm", "lstm", "ham"), there),
    )
    events = [
        Event("x", Severity.WARNING, f"event {i} " + "with a long text " * 20, 0.0, i) for i in range(9)
    ]
    return [record] * 300, events


@pytest.mark.parametrize(("columns", "rows"), [(80, 23), (40, 23), (200, 59), (60, 12), (20, 5), (132, 42)])
def test_a_page_fits_the_terminal(rig: LoopRig, columns: int, rows: int) -> None:
    lines = page(*full_page(rig), columns, rows, "greenhouse status")
    assert len(lines) <= rows
    assert all(len(text) <= columns and "\n" not in text for _, text in lines)


@pytest.mark.parametrize("columns", [40, 80])
def test_what_matters_first_is_on_the_smallest_usual_terminal(rig: LoopRig, columns: int) -> None:
    lines = page(*full_page(rig), columns, 23, "greenhouse status")
    shown = "\n".join(text for _, text in lines)
    for words in ("mode auto", "air        22.0 °C (good)", "reference  24.0 °C", "heater     0.50", "fan  ",
                  "MPC-Twin-P", "ALARM  the board is silent",
                  "ALARM  the board has tripped", "safety  the heater",
                  "why        Its rule", "event 8", "greenhouse status", "o"):  # fmt: skip
        assert words in shown
    assert (
        sum(text[:6].strip().replace(".", "").replace("-", "").isdigit() for _, text in lines) >= 4
    )  # chart


def test_a_larger_terminal_shows_the_models_and_more_events(rig: LoopRig) -> None:
    shown = "\n".join(text for _, text in page(*full_page(rig), 200, 59))
    assert "lstm in 15 min   24.3 ± 0.40" in shown
    assert all(f"event {i} " in shown for i in range(3, 9))


def test_an_emergency_stop_is_an_alarm_on_the_page(rig: LoopRig) -> None:
    style, text = page([replace(rig.tick(), mode="emergency_stop")], [], 80, 23)[0]
    assert ("red" in style, "emergency_stop" in text) == (True, True)
