"""edge/twin/effects/library.py: bounded heat without a name, and what it is for."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edge import DiagnosisResult, Run, Twin, diagnose
from edge.diagnosis.twin_choice import OPEN, candidates_of, nameless_of
from edge.diagnosis.twin_fit import FitRuns
from edge.twin.effects.library import EFFECTS, UNNAMED_EFFECTS
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import NOISE, Effects, candidates_only, simulate, twin_file

pytestmark = pytest.mark.slow

BASE = {"wall_loss": {"UA": 5.0}, "extra_capacity": {"kC": 4.0}}
HEAT = {"unnamed_heat": {"P_x": 20.0, "T_x": 30.0, "w_x": 1.0}}
CUT = {"unnamed_cut": {"f_x": 1.0, "T_x": 30.0, "w_x": 0.5}}
ROWS = 75


def settled_c(effects: dict[str, dict[str, float]], duty: float) -> float:
    """Return the air's final temperature, from a room of 20 °C."""
    commands = np.full((1, 600), duty)
    temps = BoxTwin(effects=effects).rollout(np.array([20.0]), commands, np.zeros((1, 600)), 20.0)
    assert np.isfinite(temps).all()
    return float(temps[0, -1])


def test_heat_comes_while_the_box_is_cool() -> None:
    assert settled_c(BASE | HEAT, 0.0) == pytest.approx(24.0, abs=0.1)  # 20 W through 5 W/K
    assert settled_c(BASE | HEAT, 1.0) == pytest.approx(40.0, abs=0.1)  # warm: none


def test_a_cut_takes_the_heater_from_a_warm_box() -> None:
    assert settled_c(BASE | CUT, 0.2) == pytest.approx(24.0, abs=0.1)
    assert settled_c(BASE | CUT, 1.0) == pytest.approx(30.0, abs=1.0)


@pytest.mark.parametrize("temp_c", [-200.0, 0.0, 30.0, 1000.0])
def test_it_is_bounded_wherever_the_box_goes(temp_c: float) -> None:
    twin = BoxTwin(effects=BASE | HEAT)
    heat_w = twin.signals.heat_w(np.array([temp_c]), np.array([20.0]), {}, by_temp=True)
    assert 0.0 <= float(np.asarray(heat_w)[0]) <= 20.0


def test_a_march_of_single_steps_is_the_rollout() -> None:
    duty, fan = np.array([[0.0, 1.0, 1.0, 1.0, 0.2, 0.0]]), np.zeros((1, 6))
    twin = BoxTwin(effects=BASE | CUT)
    whole = twin.rollout(np.array([28.0]), duty, fan, 20.0)[0]
    state, single = np.array([28.0]), []
    for u in duty[0]:
        state = twin.advance(state, 20.0, u, 0.0)
        single.append(state[0])
    assert np.array(single) == pytest.approx(whole)


def test_values_that_the_runs_contradict_are_opened_and_that_is_said() -> None:
    box = {"wall_loss": {"UA": 9.0}, "extra_capacity": {"kC": 10.0}}
    file = twin_file().with_values({("effects", "wall_loss", "UA"): Value(3.0, rel_sd=0.1)})
    with candidates_only("heater_lag"):
        found = diagnosed(file, box)
    assert found.document["effects"] == []
    assert found.diagnosis.adopted.effects["wall_loss"]["UA"].value == pytest.approx(9.0, rel=0.1)
    assert any("wall_loss.UA is" in line for line in found.document["findings"])
    assert found.document["provisional"] == []  # it has no name
    assert found.twin is not None


def diagnosed(file: TwinFile, box: Effects, **more: Any) -> DiagnosisResult:
    runs = [simulate(box, seed, ROWS, **more) for seed in (1, 2)]
    return diagnose(Twin(file), [Run(run.path.name, run) for run in runs])


def test_a_known_effect_of_a_fan_that_never_runs_is_no_stand_in() -> None:
    file = twin_file({**BASE, "fan_heat": {"P_fan": 3.0}})
    with candidates_only("heater_efficiency"):
        found = diagnosed(file, BASE, fan=False, further=lambda _, __, excess: 12.0 * np.sin(excess))
    assert "fan_heat" in found.diagnosis.adopted.effects  # as the file has it


def test_a_heater_that_fades_in_warm_air_stands_in_without_a_name() -> None:
    with candidates_only("fan_deadtime", "heater_derating"):
        found = diagnosed(twin_file(BASE), {**BASE, "heater_derating": {"k_P": 0.02}})
    assert not found.document["effects"]
    value = found.diagnosis.adopted.effects["heater_derating"]["k_P"].value
    assert value == pytest.approx(0.02, rel=0.1)


def test_what_no_term_follows_is_not_taken_for_noise() -> None:
    def weather(duty: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """25 W to the box or from it by the quarter of an hour, which nothing measures."""
        signs = np.random.default_rng(len(duty)).choice([-1.0, 1.0], len(duty) // 15 + 1)
        return 25.0 * np.repeat(signs, 15)[: len(duty)]

    file = replace(twin_file(BASE), sensor={"quantisation_k": 0.0, "noise_sd_k": None})
    with candidates_only("fan_deadtime"):
        found = diagnosed(file, BASE, further=weather)
    assert found.diagnosis.after.fit.rmse_k > 10.0 * NOISE.sensor_k
    assert found.verdict == "unknown"


def runs_with(fan: np.ndarray) -> FitRuns:
    still = np.zeros((1, 40))
    batch = RunBatch(np.full((1, 41), 20.0), still, fan[None], still + 20.0, {})
    return FitRuns(batch, NOISE.sensor_k, np.ones(1, dtype=bool), np.zeros(1, dtype=bool))


def test_it_is_never_offered_as_a_name() -> None:
    runs = runs_with(np.zeros(40))
    assert set(UNNAMED_EFFECTS) <= EFFECTS.keys()
    assert not set(UNNAMED_EFFECTS) & set(candidates_of(twin_file(), runs))
    assert OPEN not in nameless_of(twin_file(), runs)  # of whose values the file is sure


def test_the_heat_of_a_fan_that_a_box_does_not_have_is_no_stand_in() -> None:
    runs = runs_with(np.tile([0.0, 1.0], 20))
    assert "fan_heat" in candidates_of(twin_file(), runs)
    assert "fan_heat" not in candidates_of(replace(twin_file(), fan_role="none"), runs)
    assert "fan_heat" not in candidates_of(twin_file(), runs_with(np.zeros(40)))
