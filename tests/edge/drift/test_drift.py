"""edge/drift/monitor.py: a twin watched over a box that is that twin with noise, until the box changes."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from bench.drift_alarms import UTC_0, Chances, DriftBox, TickInputs, heat_for, switching, ticks, with_fan
from edge.bundle.store import PACKAGED_FOLDER
from edge.core.errors import DataError
from edge.core.messages import Drift, DriftState, Event
from edge.drift.kalman import Filter
from edge.drift.monitor import AGREE_S, SETTLE_S, DriftMonitor, Promise
from edge.models.pbm import read_twin
from edge.state.codecs import decode_drift, encode_drift
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands

TWIN = read_twin(PACKAGED_FOLDER / "twin.yaml").twin
HALF_FAN = with_fan(TWIN, 0.5)
PROMISE = Promise(60.0, false_alarm_days=90.0, learn_h=2.0)
LEARNT = 14 * 60  # ticks: two hours in each of four cells, which are not visited alike
QUIET = Chances(heat_w=1.5)


def run(monitor, boxes, count, seed=1, **how) -> tuple[list[Drift], list[tuple[int, Event]]]:
    """Return the verdict at each tick, and the events with their ticks. boxes : the box at tick k"""
    inputs = how.pop("inputs", None) or switching(count, seed)
    said, events = [], []
    for k, drift in enumerate(ticks(monitor, TWIN, boxes, inputs, seed, **how)):
        said.append(drift)
        events += [(k, event) for event in monitor.take_events()]
    return said, events


def keys(events: list[tuple[int, Event]]) -> list[str]:
    return [event.key for _, event in events]


# agreement and disagreement


def test_a_box_that_is_the_twin_agrees_and_the_twin_is_learnt():
    said, events = run(DriftMonitor(PROMISE), lambda k: DriftBox(TWIN), LEARNT)
    assert events == []
    assert {drift.state for drift in said[62:]} == {DriftState.AGREES}
    assert said[-1].learnt == 1.0
    assert said[-1].evidence < 0.5


@pytest.fixture(scope="module")
def half_fan():
    """The fan loses half of its effect, and has it again ten hours later."""
    monitor = DriftMonitor(PROMISE, UTC)
    halved = range(LEARNT, LEARNT + 600)
    return run(monitor, lambda k: DriftBox(HALF_FAN if k in halved else TWIN), LEARNT + 1200)


def test_a_fan_that_loses_half_its_effect_is_told_within_two_hours(half_fan):
    _, events = half_fan
    assert keys(events)[0] == "twin.disagrees"
    assert LEARNT < events[0][0] <= LEARNT + 120


def test_it_is_dated_to_the_hour_and_blamed_on_the_fan(half_fan):
    said, events = half_fan
    told, event = events[0]
    begin = UTC_0 + 60.0 * LEARNT
    assert abs(said[told].since_utc - begin) < 3600.0
    assert said[told].where in ("fan_on", "fan_started")
    assert said[told].error_k > 0.2  # less air moves, so the warm box stays warmer
    since = datetime.fromtimestamp(said[told].since_utc, UTC)
    assert event.text.startswith(f"the twin disagrees since {since:%Y-%m-%d %H:%M}, mostly ")
    assert "the fan" in event.text
    assert event.text.endswith("K warmer than it expects")


def test_it_agrees_again_an_hour_of_agreement_after_the_fan_is_right(half_fan):
    said, events = half_fan
    assert keys(events) == ["twin.disagrees", "twin.agrees_again"]
    right = LEARNT + 600
    assert right + AGREE_S / 60.0 <= events[1][0] <= right + 300
    assert said[-1].state is DriftState.AGREES
    assert said[-1].since_utc is None


def test_heat_that_lifts_the_resting_box_by_a_kelvin_is_told_within_three_hours():
    # 4.4 W, in a box whose own heat noise is 1.5 W; median of 20 boxes 43 min (bench/drift_alarms.py)
    warmer = DriftBox(TWIN, heat_w=heat_for(TWIN, 1.0))
    boxes = lambda k: warmer if k > LEARNT else DriftBox(TWIN)  # noqa: E731
    _, events = run(DriftMonitor(PROMISE), boxes, LEARNT + 181, chances=QUIET)
    assert keys(events) == ["twin.disagrees"]
    assert events[0][0] > LEARNT


def test_gross_disagreement_is_told_while_nothing_is_learnt():
    inputs = [TickInputs(0.5, float(k // 20 % 2)) for k in range(400)]
    said, events = run(DriftMonitor(PROMISE), lambda k: DriftBox(with_fan(TWIN, 0.3)), 400, inputs=inputs)
    assert keys(events)[:1] == ["twin.disagrees"]
    assert said[events[0][0]].learnt < 0.5


def test_a_door_that_is_open_for_five_minutes_is_no_disagreement():
    # 30 W leave through it; afterwards the walls are colder than the twin believes
    boxes = lambda k: DriftBox(TWIN, heat_w=-30.0 if LEARNT <= k < LEARNT + 5 else 0.0)  # noqa: E731
    said, events = run(DriftMonitor(PROMISE), boxes, LEARNT + 120)
    assert events == []
    assert said[LEARNT + 5].evidence > said[LEARNT - 1].evidence  # it was seen


# over a restart


def again(monitor: DriftMonitor) -> DriftMonitor:
    return DriftMonitor(PROMISE, memory=decode_drift(json.loads(json.dumps(encode_drift(monitor.memory)))))


def test_a_restart_keeps_what_was_learnt_and_the_alarm():
    monitor = DriftMonitor(PROMISE)
    said, _ = run(monitor, lambda k: DriftBox(TWIN if k < LEARNT else HALF_FAN), LEARNT + 150)
    assert said[-1].state is DriftState.DISAGREES
    restarted = again(monitor)
    first, events = run(restarted, lambda k: DriftBox(HALF_FAN), 90)
    assert events == []  # it was told
    assert {drift.state for drift in first} == {DriftState.DISAGREES}
    assert {drift.since_utc for drift in first} == {said[-1].since_utc}
    assert first[0].learnt == said[-1].learnt


def test_what_is_kept_of_one_twin_says_nothing_of_another():
    monitor = DriftMonitor(PROMISE)
    run(monitor, lambda k: DriftBox(TWIN), 300)
    restarted = again(monitor)
    restarted.tick(HALF_FAN, _history(), confirmed=True)
    assert restarted.memory.twin_sha256 == HALF_FAN.sha256
    assert restarted.memory.sums.sum() == 0.0


def _memory() -> dict:
    monitor = DriftMonitor(PROMISE)
    run(monitor, lambda k: DriftBox(TWIN), 65)
    return encode_drift(monitor.memory)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["sums"].pop(),
        lambda d: d.update(table=[0.0]),
        lambda d: d["table"].__setitem__(0, None),  # only the first of the evidence may hold null
        lambda d: d["evidence"].update(cusum=[]),
    ],
)
def test_a_memory_that_is_not_understood_is_refused(change):
    values = _memory()
    change(values)
    with pytest.raises(DataError):
        decode_drift(values)


# what is missing


def _history(rows: int = 2, **changes) -> dict[str, np.ndarray]:
    columns = {
        "time_s": 60.0 * np.arange(rows),
        "utc": UTC_0 + 60.0 * np.arange(rows),
        "temp_air": np.full(rows, 24.0),
        "temp_air_measured": np.full(rows, 24.0),
        "temp_ambient": np.full(rows, 21.0),
        "heater_duty": np.full(rows, 0.2),
        "fan_on": np.zeros(rows),
        "light": np.full(rows, np.nan),
    }
    return columns | {name: np.asarray(values, dtype=float) for name, values in changes.items()}


@pytest.mark.parametrize(
    ("twin", "history", "reason"),
    [
        (None, _history(), "no twin runs"),
        (TWIN, _history(0), "no air temperature yet"),
        (TWIN, _history(1), "settles"),
        (TWIN, _history(temp_air_measured=[24.0, np.nan]), "not known"),
        (TWIN, _history(temp_ambient=[np.nan, np.nan]), "not known"),
        (TWIN, _history(temp_air_measured=[24.0, np.inf]), "not known"),
        (replace(TWIN, step_s=1.0), _history(), "for steps of 1 s"),
    ],
)
def test_what_cannot_be_judged_says_why(twin, history, reason):
    monitor = DriftMonitor(PROMISE)
    drift = monitor.tick(twin, history, confirmed=True)
    assert drift.state is DriftState.UNKNOWN
    assert reason in drift.reason
    assert reason in drift.text
    assert monitor.take_events() == []


def test_an_alarm_of_a_twin_that_runs_no_more_is_not_told():
    monitor = DriftMonitor(PROMISE)
    run(monitor, lambda k: DriftBox(TWIN), 65)
    monitor.memory = replace(monitor.memory, since_utc=UTC_0)
    assert monitor.tick(TWIN, _history(3), confirmed=True).state is DriftState.DISAGREES
    assert monitor.tick(None, _history(3), confirmed=True).state is DriftState.UNKNOWN
    assert monitor.tick(HALF_FAN, _history(3), confirmed=True).state is DriftState.UNKNOWN


def test_a_column_that_the_twin_needs_and_the_rig_lacks_is_named():
    lit = replace(TWIN, effects={**TWIN.effects, "led_gain": {"P_led": 5.0}})
    monitor = DriftMonitor(PROMISE)
    monitor.tick(lit, _history(2), confirmed=True)
    assert (
        "light: not known, the twin's led_gain needs it"
        in monitor.tick(lit, _history(3), confirmed=True).reason
    )
    del (dark := _history(4))["light"]
    monitor.tick(lit, _history(3), confirmed=True)
    assert "light" in monitor.tick(lit, dark, confirmed=True).reason


@pytest.mark.parametrize("missing", [slice(300, 330), slice(70, 72), slice(0, 30)])
def test_missing_readings_are_left_out_and_raise_no_alarm(missing):
    def hide(rows, k):
        rows["temp_air_measured"][missing] = np.nan

    said, events = run(DriftMonitor(PROMISE), lambda k: DriftBox(TWIN), 500, columns=hide)
    assert events == []
    assert {drift.state for drift in said[missing]} == {DriftState.UNKNOWN}
    assert said[-1].state is DriftState.AGREES


def test_a_history_that_begins_anew_lets_the_filter_begin_anew():
    monitor = DriftMonitor(PROMISE)
    run(monitor, lambda k: DriftBox(TWIN), 120)
    later = _history(3) | {"time_s": 1e6 + 60.0 * np.arange(3)}
    assert "anew" in monitor.tick(TWIN, later, confirmed=True).reason
    assert "settles" in monitor.tick(TWIN, later, confirmed=True).reason
    assert monitor.take_events() == []


def test_maintenance_and_unconfirmed_commands_are_not_judged():
    monitor = DriftMonitor(PROMISE)
    settled = int(SETTLE_S / 60.0) + 3
    history = _history(settled + 3)
    shown = [{name: column[:k] for name, column in history.items()} for k in range(1, settled + 4)]
    for rows in shown[:settled]:
        monitor.tick(TWIN, rows, confirmed=True)
    assert monitor.tick(TWIN, shown[settled], confirmed=False, hands_in=True).reason == "maintenance"
    after = monitor.tick(TWIN, shown[settled + 1], confirmed=True)
    assert after.reason == "the board did not confirm the inputs"


class BrokenTwin(BoxTwin):
    """Whose arithmetic fails."""

    def transitions(self, fan):
        raise ZeroDivisionError("made up")


def test_a_bug_is_told_once_and_never_raised():
    broken = BrokenTwin(TWIN.geometry, TWIN.effects, 60.0)
    monitor = DriftMonitor(PROMISE)
    events = []
    for rows in range(1, 6):
        assert monitor.tick(broken, _history(rows), confirmed=True).state is DriftState.UNKNOWN
        events += monitor.take_events()
    assert [event.key for event in events] == ["drift.failed"]
    assert "made up" in events[0].text


# the filter's step is the twin's


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"constant_heat": {"P0": 3.0}, "sensor_bias": {"bias": 0.4}, "heater_sag": {"sag": 0.1}},
        {"heater_deadtime": {"d_h": 90.0}},
        {"longwave_radiation": {"epsA": 0.5}},
        {"fan_spinup": {"tau_f": 20.0}},
    ],
)
def test_one_step_is_that_of_the_twins_rollout(more):
    twin = replace(TWIN, effects={**TWIN.effects, **more})
    duty, fan = np.array([0.9, 0.4, 0.7, 0.0]), np.array([0.0, 1.0, 1.0, 0.0])
    history = _history(4, heater_duty=duty, fan_on=fan, temp_air_measured=[24.0, 24.0, 24.0, 25.0])
    stepper = Filter(twin)
    before = {name: column[:3] for name, column in history.items()}
    state = stepper.begin(before)
    _, innovation = stepper.step(state, history)
    rolled = twin.rollout(
        state.mean, duty[None, 2:3], fan[None, 2:3], np.array([21.0]), before=Commands(duty[:2], fan[:2])
    )
    assert innovation.value_k == pytest.approx(25.0 - rolled[0, 0], abs=1e-9)
