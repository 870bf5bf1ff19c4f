"""edge/evidence/figures.py: each threshold is measured as the protocol says, met, missed or left open."""

from dataclasses import replace
from pathlib import Path

import pytest
from sealed_records import NOON_UTC, STEP_S, TICKS_A_DAY, RecordRig, event, sealed_tick

from edge.core.messages import Echo, Forecast, TickRecord
from edge.evidence import figures as module
from edge.evidence.figures import MeasuredFigure, VerdictOfRecord, days_without_data, figures
from edge.evidence.marks import BEGIN, END, EvidenceMark
from edge.evidence.proof import open_record
from edge.evidence.protocol import DAYS, FAULTS, REPEATS, THRESHOLDS
from edge.evidence.record_table import RecordCollector

HOUR_S = 3600.0


@pytest.fixture(autouse=True)
def short_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three whole days instead of 30."""
    days, *others = THRESHOLDS
    monkeypatch.setattr(module, "DAYS", 3)
    monkeypatch.setattr(module, "THRESHOLDS", (replace(days, limit=3.0), *others))


def measured(rig: RecordRig, days: float = 4.0) -> tuple[dict[str, MeasuredFigure], VerdictOfRecord]:
    collector = RecordCollector()
    record = open_record(rig.seal(days), see=collector.see)
    found, verdict = figures(record, collector.table(record))
    assert [one.threshold for one in found] == list(module.THRESHOLDS)
    return {one.threshold.key: one for one in found}, verdict


def marked(what: str, begin_h: float, end_h: float) -> list[EvidenceMark]:
    """A span by hours since the start at noon."""
    return [
        EvidenceMark(NOON_UTC + HOUR_S * begin_h, what, BEGIN),
        EvidenceMark(NOON_UTC + HOUR_S * end_h, what, END),
    ]


def hour_of(record: TickRecord) -> float:
    return (record.utc - NOON_UTC) / HOUR_S


def whole_protocol() -> tuple[list[EvidenceMark], dict[float, str]]:
    """Marks of every phase, and the event that names each fault by the hour of its tick."""
    marks = [*marked("reference_1", 13.0, 17.0), *marked("reference_2", 20.0, 26.0)]
    named: dict[float, str] = {}
    begin_h = 36.0
    for _ in range(REPEATS):
        for fault in FAULTS:
            marks += marked(fault.name, begin_h, begin_h + 1.0)
            named[begin_h] = fault.keys[0]
            begin_h += 1.5
    return marks, named


def good_tick(record: TickRecord, named: dict[float, str]) -> TickRecord:
    """A tick of a rig that fulfils everything: air moves in 4 h, and the forecast knows it."""
    key = named.get(hour_of(record))
    air = 25.0 + 0.1 * (record.seq % 2)
    ahead = 25.0 + 0.1 * ((record.seq + 1) % 2)
    base = sealed_tick(record.seq, record.utc, air, forecasts={"pbm": Forecast({30: ahead})})
    return replace(base, events=(event(key, record.utc + 60.0),) if key else ())


def test_a_rig_that_meets_every_threshold_succeeds(rig: RecordRig) -> None:
    marks, named = whole_protocol()
    rig.live(3.5, lambda record: good_tick(record, named), marks)
    found, verdict = measured(rig)
    assert {key for key, one in found.items() if one.passes is not True} == set()
    assert verdict is VerdictOfRecord.SUCCESS
    assert found["mae_normal"].value == pytest.approx(0.05, abs=0.01)
    assert found["forecast"].value == pytest.approx(0.0, abs=1e-9)
    assert found["usb_pulled"].value == pytest.approx(1.0)


def test_nothing_measured_is_never_a_success(rig: RecordRig) -> None:
    rig.live(3.5)
    found, verdict = measured(rig)
    assert found["usb_pulled"].passes is None
    assert found["mae_reference_1"].note == "nothing measured"
    assert verdict is not VerdictOfRecord.SUCCESS


def test_before_the_last_day_figures_stay_open(rig: RecordRig) -> None:
    rig.live(1.5, lambda record: sealed_tick(record.seq, record.utc, 28.0))
    found, verdict = measured(rig, 2.0)
    assert (found["mae_normal"].value, found["mae_normal"].passes) == (3.0, None)
    assert verdict is VerdictOfRecord.UNFINISHED


def test_a_record_without_a_day_is_unfinished(rig: RecordRig) -> None:
    rig.live(0.1)
    found, verdict = measured(rig, 0.5)
    assert found["hottest"].value is None and found["days"].value == 0.0
    assert verdict is VerdictOfRecord.UNFINISHED


def test_a_day_with_too_few_ticks_is_a_day_without_data(rig: RecordRig) -> None:
    """The third day has 90 % of its ticks, the second 98 %."""
    gone = {*range(80, 85), 40}
    rig.live(3.5, lambda record: None if record.seq in gone else record)
    collector = RecordCollector()
    record = open_record(rig.seal(4.0), see=collector.see)
    ((day, share),) = days_without_data(record, collector.table(record))
    assert (day.date, share) == ("2026-01-03", pytest.approx(1.0 - 5 / TICKS_A_DAY))


def test_lost_and_skipped_ticks_are_counted_together(rig: RecordRig) -> None:
    def change(record: TickRecord) -> TickRecord | None:
        if record.seq == 40:
            return None
        return replace(record, ticks_skipped=2) if record.seq == 50 else record

    found, _ = measured(rig.live(3.5, change))
    all_ticks = 3.5 * TICKS_A_DAY
    assert found["lost"].value == pytest.approx(100.0 * 3 / (all_ticks + 2))
    assert (found["lost"].passes, found["unexplained"].value) == (False, 1.0)


def test_ticks_that_a_power_cut_cost_are_no_loss_but_need_a_reason(rig: RecordRig) -> None:
    marks = marked("power_cut", 14.0, 17.0)
    rig.live(3.5, lambda record: None if 15.0 <= hour_of(record) <= 16.0 else record, marks)
    found, _ = measured(rig)
    assert (found["lost"].value, found["unexplained"].value) == (0.0, 3.0)


def test_heat_without_an_air_reading_is_counted(rig: RecordRig) -> None:
    hot = Echo(0.5, False, 0.0, False, False, "", 0.0)
    rig.live(
        3.5,
        lambda record: sealed_tick(record.seq, record.utc, None, echo=hot) if record.seq == 60 else record,
    )
    found, verdict = measured(rig)
    assert (found["blind_heat"].value, found["blind_heat"].passes) == (1.0, False)
    assert verdict is VerdictOfRecord.FAILURE


def test_heat_while_the_sensor_is_away_counts_from_the_second_tick_on(rig: RecordRig) -> None:
    hot = Echo(0.5, False, 0.0, False, False, "", 0.0)
    marks = marked("sensor_unplugged", 14.0, 17.0)

    def change(record: TickRecord) -> TickRecord:
        is_away = 14.0 < hour_of(record) <= 16.5
        return sealed_tick(record.seq, record.utc, None, echo=hot) if is_away else record

    found, _ = measured(rig.live(3.5, change, marks))
    assert found["heat_after"].value == 3.0  # 15.5, 16.0 and 16.5 h
    assert found["blind_heat"].value == 0.0  # the fault's own criterion counts them


@pytest.mark.parametrize(
    ("key", "text", "hour", "count"),
    [
        ("safety.heater_stuck_on", "", 20.0, 1.0),
        ("board.tripped", "the board has tripped: over_temperature", 20.0, 1.0),
        ("board.tripped", "the board has tripped: emergency_stop", 20.0, 0.0),
        ("board.tripped", "the board has tripped: maintenance", 20.0, 0.0),
        ("reading.not_good", "", 20.0, 0.0),
        ("safety.heater_no_effect", "", 30.0, 0.0),  # inside of the provoked fault
    ],
)
def test_a_trip_is_false_where_nobody_provoked_it(
    rig: RecordRig, key: str, text: str, hour: float, count: float
) -> None:
    marks = marked("heater_supply_cut", 29.0, 31.0)

    def change(record: TickRecord) -> TickRecord:
        return replace(record, events=(event(key, record.utc, text),)) if hour_of(record) == hour else record

    found, _ = measured(rig.live(3.5, change, marks))
    assert found["false_trips"].value == count


def test_a_fault_that_is_never_named_fails_at_once(rig: RecordRig) -> None:
    rig.live(1.5, marks=marked("fan_blocked", 2.0, 3.0))
    found, verdict = measured(rig, 2.0)
    assert (found["fan_blocked"].value, found["fan_blocked"].passes) == (float("inf"), False)
    assert verdict is VerdictOfRecord.FAILURE


def test_an_event_after_the_mark_ended_names_nothing(rig: RecordRig) -> None:
    def change(record: TickRecord) -> TickRecord:
        is_late = hour_of(record) == 4.0
        return replace(record, events=(event("board.unplugged", record.utc),)) if is_late else record

    found, _ = measured(rig.live(3.5, change, marked("usb_pulled", 2.0, 3.0)))
    assert found["usb_pulled"].value == float("inf")


def test_turning_the_controller_off_does_not_spare_the_rig(rig: RecordRig) -> None:
    """A person who switches to manual in bad hours loses the share of automatic control."""

    def change(record: TickRecord) -> TickRecord:
        is_manual = record.seq % 4 == 0
        return sealed_tick(
            record.seq, record.utc, 29.0 if is_manual else 25.0, mode="manual" if is_manual else "auto"
        )

    found, _ = measured(rig.live(3.5, change))
    assert found["mae_normal"].value == 0.0
    assert found["controlled"].value == pytest.approx(75.0, abs=1.0)
    assert found["controlled"].passes is False


def test_marking_bad_hours_does_not_spare_the_rig(rig: RecordRig) -> None:
    found, _ = measured(rig.live(3.5, marks=marked("hands", 10.0, 60.0)))
    assert found["normal"].value == pytest.approx(100.0 * (1.0 - 50.0 / 84.0), abs=1.0)
    assert found["normal"].passes is False


def test_a_forecast_is_scored_against_the_air_thirty_minutes_later(rig: RecordRig) -> None:
    """The air rises 0.2 K a tick of 30 min; the forecast says 0.15 K."""

    def change(record: TickRecord) -> TickRecord:
        air = 10.0 + 0.2 * record.seq
        return sealed_tick(record.seq, record.utc, air, forecasts={"pbm": Forecast({30: air + 0.15})})

    assert STEP_S == 1800.0
    found, _ = measured(rig.live(3.5, change, marked("reference_2", 20.0, 40.0)))
    assert found["forecast"].value == pytest.approx(0.05)
    assert found["against_persistence"].value == pytest.approx(0.25)


def test_a_mark_that_was_put_in_later_does_not_count(rig: RecordRig) -> None:
    rig.live(3.5)
    rig.extend(2.0)
    line = '{"utc": %f, "what": "hands", "edge": "begin", "text": ""}\n' % (NOON_UTC + HOUR_S)
    (rig.chain / "marks.jsonl").write_text(line)
    collector = RecordCollector()
    record = open_record(rig.seal(4.0), see=collector.see)
    table = collector.table(record)
    assert (len(table.late_marks), table.marked) == (1, ())


def test_the_protocols_own_length_is_thirty_days(tmp_path: Path) -> None:
    assert DAYS == 30
    assert len({one.key for one in THRESHOLDS}) == len(THRESHOLDS)
    assert {fault.name for fault in FAULTS} <= {one.key for one in THRESHOLDS}
