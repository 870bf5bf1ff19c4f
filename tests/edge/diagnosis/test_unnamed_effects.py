"""edge/twin/effects/library.py: bounded heat without a name, and what it is for."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.candidates import Candidates
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.handover import OPEN, JudgedTwin, free_values
from edge.diagnosis.judgement import LESS_UNNAMED, _is_known, _is_moved, _moves, _worth_k
from edge.diagnosis.trial import FittedTwin, Trial
from edge.diagnosis.unknowns import UnknownValue
from edge.twin.effects.library import EFFECTS, UNNAMED_EFFECTS
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.value import Value
from tests.support.simulated_runs import (
    NOISE,
    as_diagnosis_runs,
    candidates_only,
    silent,
    simulate,
    twin_file,
)

pytestmark = pytest.mark.slow

BASE = {"wall_loss": {"UA": 5.0}, "extra_capacity": {"kC": 4.0}}
HEAT = {"unnamed_heat": {"P_x": 20.0, "T_x": 30.0, "w_x": 1.0}}
CUT = {"unnamed_cut": {"f_x": 1.0, "T_x": 30.0, "w_x": 0.5}}
ROWS = 600


def settled_c(effects: dict[str, dict[str, float]], duty: float) -> float:
    """Return the air's final temperature, from a room of 20 °C."""
    commands = np.full((1, ROWS), duty)
    temps = BoxTwin(effects=effects).rollout(np.array([20.0]), commands, np.zeros((1, ROWS)), 20.0)
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
    runs = [simulate(box, seed, 50) for seed in (1, 2)]
    wrong = {("effects", "wall_loss", "UA"): Value(3.0, rel_sd=0.1)}
    file = twin_file().with_values(wrong)
    with candidates_only("heater_lag"):
        found = diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")
    fitted = found.adopted.effects["wall_loss"]["UA"]
    assert fitted.value == pytest.approx(9.0, rel=0.1) or found.verdict.kind == "named"
    if OPEN in found.judgement.handover.added:
        assert any("wall_loss.UA is" in line for line in found.judgement.notes)


def test_a_known_effect_of_a_fan_that_never_runs_is_no_stand_in() -> None:
    file = twin_file({**BASE, "fan_heat": {"P_fan": 3.0}})
    runs = [
        simulate(BASE, seed, 50, fan=False, further=lambda _, __, excess: 12.0 * np.sin(excess))
        for seed in (1, 2)
    ]
    with candidates_only("heater_efficiency"):
        found = diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")
    assert "fan_heat" in found.adopted.effects  # as the file has it


def test_a_heater_that_fades_in_warm_air_stands_in_without_a_name() -> None:
    runs = [simulate({**BASE, "heater_derating": {"k_P": 0.02}}, seed, 60) for seed in (1, 2)]
    file = twin_file(BASE)
    with candidates_only("fan_deadtime"):
        found = diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")
    assert not found.verdict.effects
    assert found.adopted.effects["heater_derating"]["k_P"].value == pytest.approx(0.02, rel=0.1)


def test_what_no_term_follows_is_not_taken_for_noise() -> None:
    def weather(duty: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """25 W to the box or from it by the quarter of an hour, which nothing measures."""
        signs = np.random.default_rng(len(duty)).choice([-1.0, 1.0], len(duty) // 15 + 1)
        return 25.0 * np.repeat(signs, 15)[: len(duty)]

    runs = [simulate(BASE, seed, 75, further=weather) for seed in (1, 2)]
    file = replace(twin_file(BASE), sensor={"quantisation_k": 0.0, "noise_sd_k": None})
    with candidates_only("fan_deadtime"):
        found = diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")
    assert found.judgement.handover.rmse_k > 10.0 * NOISE.sensor_k
    assert found.judgement.comparison.noise_k > 10.0 * NOISE.sensor_k  # by the likelihood alone
    assert found.verdict.kind == "unknown"


def test_opened_values_are_adopted_like_any_other() -> None:
    file = twin_file().with_values({("effects", "wall_loss", "UA"): Value(3.0, rel_sd=0.1)})
    assert free_values(file).to_fit() == [("effects", "wall_loss", "UA")]


def test_it_is_never_offered_as_a_name() -> None:
    runs = RunBatch(np.full((1, 41), 20.0), np.zeros((1, 40)), np.zeros((1, 40)), np.full((1, 40), 20.0), {})
    assert set(UNNAMED_EFFECTS) <= EFFECTS.keys()
    assert not set(UNNAMED_EFFECTS) & set(Candidates(twin_file(), runs, {}).names)


def predicted(
    added: set[str], places: dict[tuple[str, str, str], float], sd: float = 0.1, error_k: float = 0.0
) -> JudgedTwin:
    """A twin of which no more is told than its values, and what it misses by."""
    free = tuple(UnknownValue(place, 1e-3, 1e3, True, 1.0, 0.0, 1.0) for place in places)
    file, coordinates = twin_file(), np.array(list(places.values()))
    fitted = FittedTwin(
        Trial(file, NOISE), file, free, coordinates, 0.0, sd**2 * np.eye(len(free)), np.zeros((1, 1)),
        np.empty(0), np.empty(0),
    )  # fmt: skip
    return JudgedTwin(frozenset(added), fitted, np.full((1, 1), error_k))


def test_a_term_without_a_cause_gives_way_to_one_with_a_cause_that_is_nearly_as_good() -> None:
    handed = predicted({"heater_lag"}, {})
    caused = predicted({"heater_lag", "heater_derating"}, {}, error_k=0.14)
    near, far = (predicted({"heater_lag", "unnamed_cut"}, {}, error_k=error_k) for error_k in (0.13, 0.09))
    assert min((caused, near), key=lambda item: _worth_k(item, handed)) is caused
    assert min((caused, far), key=lambda item: _worth_k(item, handed)) is far
    assert _worth_k(far, handed) == pytest.approx(0.09 / LESS_UNNAMED)
    assert _worth_k(far, far) == pytest.approx(0.09)  # the twin has it already


def test_a_name_that_moves_keeps_out_what_it_may_stand_for_and_not_what_any_warm_box_has() -> None:
    assert _is_known(frozenset({"natural_convection"})) and _is_known(frozenset({"heater_derating"}))
    for name in ("soil_mass", "unnamed_heat", OPEN):
        assert not _is_known(frozenset({name}))


def test_the_heat_of_a_fan_that_a_box_does_not_have_is_no_stand_in() -> None:
    fan = np.tile([0.0, 1.0], 20)[None]
    runs = RunBatch(np.full((1, 41), 20.0), np.zeros((1, 40)), fan, np.full((1, 40), 20.0), {})
    heat = EFFECTS["fan_heat"]
    assert _moves(heat, twin_file(), runs)
    assert not _moves(heat, replace(twin_file(), fan_role="none"), runs)


def test_a_name_that_becomes_something_else_beside_a_term_is_moved() -> None:
    lag, loss = ("effects", "heater_lag", "tau_h"), ("effects", "wall_loss", "UA")
    named = predicted({"heater_lag"}, {loss: 1.0, lag: 5.0})
    assert not _is_moved(named, predicted({"heater_lag", "x"}, {loss: 3.0, lag: 5.2}))
    assert _is_moved(named, predicted({"heater_lag", "x"}, {loss: 1.0, lag: 6.0}))
    # where a wall that stores heat replaces the loss, there is no loss to compare
    assert not _is_moved(named, predicted({"heater_lag", "wall_mass"}, {lag: 5.0}))
