"""edge/display.py: what a person sees of a tick."""

import io
from collections.abc import Iterator
from dataclasses import replace

import pytest
from loop_rig import LoopRig

from edge.display import CHART_ROWS, LineDisplay, chart_rows, forecast_facts, make_display, tick_line
from edge.messages import Command, Decision, Forecast, ForecastSkill, Quality, TickRecord
from edge.tick_json import tick_json


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


def test_a_reading_without_a_number_shows_its_quality_and_no_number(rig: LoopRig) -> None:
    rig.board.temp_air, rig.board.quality = None, Quality.FAULT
    shown = line(rig.tick())
    assert "air (fault)" in shown
    assert "reading.not_good" not in shown  # events are told in words
    assert "the air temperature is not good" in shown


def test_what_safety_changed_is_named(rig: LoopRig) -> None:
    rig.chosen.command = Command(heater_duty=7.0)
    assert "safety heater." in line(rig.tick())


def test_lines_come_out_one_per_tick(rig: LoopRig) -> None:
    out = io.StringIO()
    display = make_display(out)
    assert isinstance(display, LineDisplay)  # a StringIO is no terminal
    display.show(rig.tick())
    display.show(rig.tick())
    display.close()
    assert len(out.getvalue().splitlines()) == 2


def test_the_chart_has_its_rows_whatever_the_numbers(rig: LoopRig) -> None:
    record = rig.tick()
    hot = replace(record, decision=Decision(Command(), "x", forecast=(90.0, float("nan"), -5.0)))
    for records in ([record], [record, hot], [hot] * 200):
        rows = chart_rows(records[-72:])
        assert len(rows) == CHART_ROWS
        assert len({len(row) for row in rows}) == 1
        assert any("o" in row for row in rows)


def test_a_chart_without_any_number_says_so(rig: LoopRig) -> None:
    record = rig.tick()
    nothing = replace(
        record, estimate=replace(record.estimate, temp_air=float("nan")), reference_c=float("nan")
    )
    assert chart_rows([nothing]) == ["no air temperature yet"]


def test_each_models_forecast_is_shown_where_there_is_one(rig: LoopRig) -> None:
    there = Forecast({1: 22.0, 15: 24.26}, {15: 0.4}, outside=True)
    record = replace(rig.tick(), forecasts={"arx": there, "lstm": Forecast(reason="too few rows")})
    assert "in 15 min arx 24.3  safety" in line(record)
    skill = ForecastSkill("arx", "1", 15, 9, 0.123, None, None, None, None)
    facts = dict(forecast_facts(replace(record, skill=(skill,))))
    assert facts == {"arx in 15 min": "24.3 +- 0.40 (90 %) degC, off by 0.12 K lately, untrained there"}
