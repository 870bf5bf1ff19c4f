"""app/replay.py, board/recorded_board.py: a recording takes the board's place, nothing in it is changed."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from edge.app.replay import decisions_digest, fired_limits, replay, score
from edge.commands.replay import settings_for, skill_table
from edge.core.errors import DataError
from edge.core.messages import ReadingQuality, TickRecord
from edge.core.predictor import Columns, Floats
from edge.formats.run_file import RecordedRun, read_run
from edge.formats.run_lines import OPTION_WITHOUT
from edge.formats.tick_json import tick_json
from edge.models.arx import Arx
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin

pytestmark = pytest.mark.slow

STEP_S = 10.0
LOGS = Path(__file__).parents[4] / "shared" / "data" / "heated_box"

# A box that warms 0.1 K a step at full heat and loses 1 % of its excess over 20 degC: the recording's truth.
TRUE_BOX = Arx(np.array([0.99]), np.array([0.1]), np.array([-0.05]), 0.0, intercept=0.2, step_s=STEP_S)


def recording(rows: int = 90, missing: int | None = None) -> RecordedRun:
    """Return TRUE_BOX under a duty that changes every five minutes."""
    duty = np.where(np.arange(rows) // 30 % 2 == 0, 0.8, 0.2)
    fan = np.where(np.arange(rows) // 45 % 2 == 0, 0.0, 1.0)
    temp = np.empty(rows)
    temp[0] = 21.0
    for row in range(rows - 1):
        temp[row + 1] = 0.99 * temp[row] + 0.1 * duty[row] - 0.05 * fan[row] + 0.2
    if missing is not None:
        temp[missing : missing + 5] = np.nan
    times = STEP_S * np.arange(rows)
    return RecordedRun({"time_s": times, "temp_air_c": temp, "heater_duty": duty, "fan_on": fan})


def replayed(run: RecordedRun) -> list[TickRecord]:
    return replay(run, settings_for(STEP_S, "MPC", 24.0), TRUE_BOX, fan_always_on=False)


@cache
def usual(missing: int | None = None) -> list[TickRecord]:
    """The usual recording's replay, made once."""
    return replayed(recording(missing=missing))


def test_there_is_one_tick_per_step_and_it_sees_what_was_measured() -> None:
    run = recording()
    records = usual()
    assert len(records) in (89, 90)
    for row, record in enumerate(records):
        reading = record.readings["temp_air"]
        assert reading.quality is ReadingQuality.GOOD
        assert reading.value == pytest.approx(run.columns["temp_air_c"][row])


def test_what_was_recorded_stands_whatever_the_controller_wants() -> None:
    run = recording()
    for row, record in enumerate(usual()):
        assert record.echo is not None
        assert record.echo.heater_duty == pytest.approx(run.columns["heater_duty"][row])
        assert record.echo.fan_on == bool(run.columns["fan_on"][row])


def test_the_controller_says_what_it_would_have_done() -> None:
    records = usual()
    assert {record.decision.controller for record in records} == {"MPC"}
    assert any(record.wanted.heater_duty > 0.5 for record in records)  # 24 degC is above the recorded box


def test_two_replays_decide_the_same_bit_for_bit() -> None:
    first, second = usual(), replayed(recording())
    assert decisions_digest(first) == decisions_digest(second)


def test_another_recording_has_another_digest() -> None:
    assert decisions_digest(usual()) != decisions_digest(usual(missing=40))


def test_a_predictor_that_is_the_truth_is_scored_as_such() -> None:
    records = usual()
    for skill in score(records, TRUE_BOX, (10.0, 60.0, 300.0)):
        assert skill.model_mae_k < 0.02
        assert skill.model_mae_k < 0.5 * skill.persistence.mean()


@dataclass(frozen=True)
class Witness:
    """A predictor that keeps what it is given."""

    given: list[tuple[Columns, Columns]]
    name: str = "witness"
    version: str = ""
    step_s: float = STEP_S
    rows_needed: int = 1

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        self.given.append((history, ahead))
        return np.full(controls.shape[:2], history["temp_air"][-1])


def test_a_predictor_is_handed_every_column_that_effects_need() -> None:
    run = recording()
    light = np.linspace(0.0, 1.0, len(run))
    lit = replace(
        run,
        columns={**run.columns, "light": light, "rel_humidity_pct": 50.0 + light},
        facts={"start_utc": "2026-07-01T12:00:00Z"},
    )
    witness = Witness([])
    score(replayed(lit), witness, (60.0,))
    history, ahead = witness.given[10]  # at row 10, with 11 rows of history
    assert history["light"] == pytest.approx(light[:11])
    assert history["rel_humidity"] == pytest.approx(50.0 + light[:11])
    assert history["utc"] == pytest.approx(lit.start_utc + STEP_S * np.arange(11))
    # Nothing is known of later rows: what was measured stays, time goes on.
    assert set(ahead["light"]) == {light[10]}
    assert ahead["utc"] == pytest.approx(lit.start_utc + STEP_S * np.arange(10, 16))


def test_a_wrong_predictor_is_scored_worse() -> None:
    wrong = replace(TRUE_BOX, heater=np.zeros(1), fan=np.zeros(1))
    records = usual()
    (good,), (bad,) = score(records, TRUE_BOX, (300.0,)), score(records, wrong, (300.0,))
    assert bad.model_mae_k > 5 * good.model_mae_k


def test_rows_without_a_temperature_are_forecast_but_not_scored() -> None:
    whole = score(usual(), TRUE_BOX, (10.0,))[0]
    holed = score(usual(missing=40), TRUE_BOX, (10.0,))[0]
    assert len(holed.model) < len(whole.model)
    assert np.isfinite(holed.model).all()


def test_a_horizon_longer_than_the_run_gives_no_forecasts_and_says_so() -> None:
    skills = score(replayed(recording(rows=20)), TRUE_BOX, (600.0,))
    assert len(skills[0].model) == 0
    assert "0      -" in skill_table([skills])[1]


@pytest.mark.skipif(not LOGS.exists(), reason="the measured logs are not part of the repository")
def test_a_measured_log_replays_the_same_twice() -> None:
    run = read_run(sorted(LOGS.glob("*.csv"))[-1], without=OPTION_WITHOUT)
    model = Arx(np.array([1.0]), np.array([0.03]), np.zeros(1), 0.0, intercept=0.0, step_s=STEP_S)
    settings = settings_for(STEP_S, "MPC", 23.0)
    first, second = (replay(run, settings, model, fan_always_on=True) for _ in range(2))
    assert decisions_digest(first) == decisions_digest(second)
    assert all(record.readings["temp_ambient"].quality is ReadingQuality.ABSENT for record in first)


def test_a_twins_controller_is_replayed_bit_for_bit() -> None:
    run, settings = recording(), settings_for(STEP_S, "MPC-Twin-P", 24.0)
    twin = Pbm(BoxTwin(step_s=STEP_S))
    first, second = (replay(run, settings, TRUE_BOX, False, twin=twin) for _ in range(2))
    assert {record.decision.controller for record in first} == {"MPC-Twin-P"}
    assert decisions_digest(first) == decisions_digest(second)


def test_safety_knows_the_box_of_the_twin_that_is_given(tmp_path: Path) -> None:
    """In a box of 4 kJ/K a still sensor under full heat is stuck after 20 min, in one of 180 kJ/K not."""
    rows = 200
    still = {"time_s": STEP_S * np.arange(rows), "temp_air_c": np.full(rows, 30.0)}
    more = {"temp_ambient_c": np.full(rows, 20.0), "heater_duty": np.ones(rows), "fan_on": np.zeros(rows)}
    qualities = []
    for times_air in (20.0, 1000.0):
        path = tmp_path / f"{times_air:g}.yaml"
        path.write_text(f"effects: {{wall_loss: {{UA: 3.0}}, extra_capacity: {{kC: {times_air}}}}}\n")
        settings = settings_for(STEP_S, "MPC", 24.0, path)
        ticks = replay(RecordedRun(still | more), settings, TRUE_BOX, fan_always_on=False)
        qualities.append(ticks[-2].readings["temp_air"].quality)
    assert qualities == [ReadingQuality.STUCK, ReadingQuality.GOOD]


def test_a_twin_of_another_step_is_refused() -> None:
    with pytest.raises(DataError, match="sample_s"):
        replay(recording(), settings_for(STEP_S, "MPC", 24.0), TRUE_BOX, False, twin=Pbm(BoxTwin(step_s=7.0)))


def test_a_decision_that_the_clock_cut_short_is_replayed_to_the_same_node() -> None:
    run, settings = recording(), settings_for(STEP_S, "MPC-P", 22.0)
    free = replay(run, settings, TRUE_BOX, fan_always_on=False)
    nodes = [record.decision.why["nodes"] for record in free]
    hardest = nodes.index(max(nodes[1:]), 1)  # the first one has no plan to fall back on
    cut: list[int | None] = [None] * len(nodes)
    cut[hardest] = 1
    first = replay(run, settings, TRUE_BOX, False, cut)
    assert first[hardest].decision.why["time_box_fired"] is True
    recorded = [tick_json(record) for record in first]
    again = replay(run, settings, TRUE_BOX, False, fired_limits(recorded))
    assert decisions_digest(again) == decisions_digest(first)
    assert decisions_digest(free) != decisions_digest(first)
