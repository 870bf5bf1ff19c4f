"""The experiment that tells rivals apart: what it does, what it keeps to, and that it tells what it says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from designed import (
    BLOWN,
    DUTIES,
    ONE_DUTY,
    ROOM_C,
    STILL,
    RunInputs,
    as_inputs,
    driven,
    experiment_of,
    file_of,
    fit_runs,
    fitted,
    joined,
    pairs_of,
    plan_of,
)
from diagnosis_examples import named_story
from safety_cases import NOW, UTC, view

from edge.config.settings import SafetySettings
from edge.core.messages import Command
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.diagnosis_file import check_diagnosis
from edge.diagnosis.experiment.document import PROFILE, experiment_document, write_profile
from edge.diagnosis.experiment.plan import PlannedExperiment, design_experiment, next_experiment
from edge.diagnosis.experiment.separation import EXACT_SD, separation
from edge.diagnosis.experiment.sequence import ExperimentLimits, candidates, surroundings
from edge.diagnosis.twin_fit import FittedTwin, begun, fit_twins
from edge.formats.profile_file import read_profile
from edge.formats.run_file import RecordedRun
from edge.safety.supervisor import SafetyMemory, supervise
from edge.twin.value import Value
from tests.support import simulated_runs
from tests.support.simulated_runs import (
    STEP_S,
    as_diagnosis_runs,
    candidates_only,
    silent,
    simulate,
    twin_file,
)

AIR = {"extra_capacity": {"kC": 10.0}}
BOX = {**AIR, "wall_loss": {"UA": 5.0}}
LEAKY = {**AIR, "infiltration": {"F_inf": 0.004}}  # 4.8 W/K with the fan off
SATURATED = {**BOX, "heater_saturation": {"u_sat": 0.45}}
NO_FAN = [RunInputs(DUTIES, STILL), RunInputs(DUTIES[::-1].copy(), STILL)]
HEATER = ("heater_efficiency", "heater_saturation", "heater_sag")


@pytest.fixture(scope="module")
def leak_plan():
    return plan_of(file_of(AIR), driven(LEAKY, NO_FAN), ("wall_loss", "infiltration"))


def test_loss_and_leak_are_told_apart_by_switching_the_fan(leak_plan):
    found = design_experiment(leak_plan, ExperimentLimits())
    assert set(found.profile["fan_on"]) == {0.0, 1.0}
    assert max(found.profile["heater_duty"]) > 0.0
    assert found.names == ["wall_loss", "infiltration"]
    assert found.expected_log_odds > 5.0
    assert "separates wall_loss from infiltration" in experiment_document(found)["why"]


def test_efficiency_saturation_and_sag_are_told_apart_by_several_duties():
    fans = [BLOWN, STILL]
    runs = driven(SATURATED, [RunInputs(ONE_DUTY, fan) for fan in fans])
    found = experiment_of(file_of(BOX), runs, HEATER)
    levels = set(found.profile["heater_duty"]) - {0.0}
    assert len(levels) >= 3
    assert set(found.names) == set(HEATER)
    assert found.expected_log_odds > 5.0


def test_a_lagging_heater_and_a_lagging_sensor_are_told_apart_by_the_fan():
    box = {**BOX, "heater_lag": {"tau_h": 120.0}}
    found = experiment_of(file_of(BOX), driven(box, NO_FAN), ("heater_lag", "sensor_lag"))
    assert set(found.profile["fan_on"]) == {0.0, 1.0}
    assert found.expected_log_odds > 10.0


def test_the_lamp_is_turned_off_where_its_heat_is_in_question():
    lit = [RunInputs(item.duty, item.fan, np.full(len(DUTIES), 1.0)) for item in NO_FAN]
    runs = driven({**BOX, "led_gain": {"P_led": 4.0}}, lit)
    found = experiment_of(file_of(BOX), runs, ("led_gain", "constant_heat"))
    assert 0.0 in found.profile["light"][:-1]  # it was on all the time
    assert found.expected_log_odds > 5.0


def test_fan_effectiveness_and_short_circuit_are_said_to_be_the_same():
    runs = driven(
        {**BOX, "fan_effectiveness": {"eps_f": 0.7}}, [RunInputs(DUTIES, BLOWN), RunInputs(DUTIES, STILL)]
    )
    found = experiment_of(file_of(BOX), runs, ("fan_effectiveness", "short_circuit"))
    document = experiment_document(found)
    assert not found.profile
    assert "profile" not in document
    assert document["separates"] == []
    assert document["expected_log_odds"] is None
    assert (
        "No experiment with heater and fan can tell fan_effectiveness and short_circuit apart"
        in document["why"]
    )
    assert "anemometer" in document["why"]


def test_an_experiment_that_settles_nothing_still_says_what_it_tells_a_little_of(
    leak_plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("edge.diagnosis.experiment.plan.RIVAL_NATS", 1e6)  # nothing is worth that much
    found = design_experiment(leak_plan, ExperimentLimits())
    assert found.names == ["wall_loss", "infiltration"]
    write_profile(found, tmp_path)
    assert "to separate wall_loss, infiltration" in (tmp_path / PROFILE).read_text(encoding="utf-8")


def test_two_that_are_the_same_are_told_from_a_third_together():
    runs = driven(SATURATED, [RunInputs(ONE_DUTY, BLOWN), RunInputs(ONE_DUTY, STILL)])
    names = ("heater_efficiency", "radiative_split", "heater_saturation")  # without a wall radiation is lost
    found = experiment_of(file_of(BOX), runs, names)
    assert found.inseparable == (("heater_efficiency", "radiative_split"),)
    assert set(found.names) == set(names)
    assert not found.weak


def test_a_longer_experiment_that_settles_a_question_is_preferred(leak_plan):
    limits = ExperimentLimits(SafetySettings(heater_max_duty=0.05))
    inputs = candidates(limits, leak_plan.around, STEP_S)
    log_odds = leak_plan.log_odds(inputs).min(axis=1)[0]
    lasts = inputs.within.sum(axis=1)
    assert log_odds[lasts == lasts.min()].max() < 3.0 < log_odds.max()
    assert design_experiment(leak_plan, limits).expected_log_odds > 3.0


def missed(fit: FittedTwin, error_k: float) -> float:
    """Half the sum of squares, in standard deviations of an error."""
    return 0.5 * float(np.nansum(fit.errors**2)) / error_k**2


def test_what_is_expected_is_what_simulated_runs_then_give(leak_plan):
    """Mean over seeds of the true rival's gain by the new run, both refitted on all runs."""
    limits = ExperimentLimits(SafetySettings(heater_max_duty=0.1))
    runs, found = driven(LEAKY, NO_FAN), design_experiment(leak_plan, limits)
    error_k, gains = leak_plan.models[0].error_k, []
    for seed in range(1, 5):
        together = joined(runs, driven(LEAKY, [as_inputs(found)], seed))
        before, after = (
            [missed(fitted(file_of(AIR), given, name), error_k) for name in ("infiltration", "wall_loss")]
            for given in (runs, together)
        )
        gains.append((after[1] - after[0]) - (before[1] - before[0]))
    expected = found.expected_log_odds
    assert 2.0 < expected < 60.0  # else the comparison would say little
    assert 0.5 * expected < np.mean(gains) < 2.0 * expected


def test_calibrating_the_fan_is_worth_what_a_fit_with_the_exact_value_then_gives():
    """A loss in runs in which the fan always runs: a stronger fan explains it nearly as well, within 5 %."""
    known = {**AIR, "fan_effectiveness": {"eps_f": 0.7}}
    runs = driven(
        {**known, "wall_loss": {"UA": 1.2}}, [RunInputs(DUTIES, BLOWN), RunInputs(DUTIES[::-1].copy(), BLOWN)]
    )
    file = file_of(known, {"fan_effectiveness": 0.05})
    plan = plan_of(file, runs, ("wall_loss", "infiltration"))
    place = ("effects", "fan_effectiveness", "eps_f")
    alone = plan.by_calibration(place)[0, 0]
    loss, leak = plan.models
    truth, scale = loss.file.values()[place].value, leak.free[0].scale
    (exact,) = fit_twins([begun(leak.file.with_values({place: Value(truth)}))], fit_runs(runs), 12)
    lost = missed(exact, leak.error_k) - missed(leak, leak.error_k)
    # A calibration is not quite exact: its variance adds to that which the runs leave.
    off = leak.x[0] - truth / scale
    by_calibration = 0.5 * off**2 / (0.5 * off**2 / lost + EXACT_SD**2)
    assert alone == pytest.approx(by_calibration, rel=0.4)
    assert alone > 3.0


def test_a_value_that_would_settle_it_is_named_with_the_way_to_calibrate_it(leak_plan):
    known = {**AIR, "fan_effectiveness": {"eps_f": 0.7}}
    blown = [RunInputs(DUTIES, BLOWN), RunInputs(DUTIES[::-1].copy(), BLOWN)]
    runs = driven({**known, "wall_loss": {"UA": 1.2}}, blown)
    plan = plan_of(file_of(known, {"fan_effectiveness": 0.05}), runs, ("wall_loss", "infiltration"))
    sure = tuple(replace(model, covariance=0.01 * model.covariance) for model in plan.models)
    found = design_experiment(replace(plan, models=sure), ExperimentLimits())
    document = experiment_document(found)
    assert found.calibration is not None
    place, log_odds = found.calibration
    assert place == ("effects", "fan_effectiveness", "eps_f")
    assert log_odds > 10.0
    assert "Calibrating fan_effectiveness.eps_f first (a calibration of the fan's flow" in document["why"]
    assert design_experiment(leak_plan, ExperimentLimits()).calibration is None


DRAWS = 8


@pytest.mark.parametrize("seed", range(DRAWS))
def test_the_safety_supervisor_changes_nothing_but_the_rise(leak_plan, seed):
    """Any limits: what is planned is what is sent, and no rival gets too warm by it."""
    draw = np.random.default_rng(seed)
    safety = SafetySettings(
        temp_air_max_c=float(draw.uniform(28.0, 42.0)),
        heater_max_duty=float(draw.uniform(0.1, 1.0)),
        heater_rise_per_s=float(draw.choice([0.05, 0.004, 0.001])),
        fan_min_on_s=float(draw.choice([0.0, 60.0, 300.0, 900.0])),
        fan_min_off_s=float(draw.choice([0.0, 61.0, 240.0, 1200.0])),
        fan_switches_hour_max=int(draw.choice([2, 5, 60])),
        energy_hour_max_wh=float(draw.choice([100.0, 20.0, 9.0])),
    )
    limits = ExperimentLimits(safety)
    found = design_experiment(leak_plan, limits)
    assert found.profile
    assert found.largest_temp_air_c <= limits.highest_c == safety.temp_air_max_c - 2.0
    planned = as_inputs(found)
    levels = 20.0 * planned.duty
    assert levels == pytest.approx(np.round(levels), abs=1e-9)  # steps of 0.05
    duty = limits.limit_rise(planned.duty[None], STEP_S)[0]
    memory = SafetyMemory()
    for k in range(len(duty)):
        at = {"now_s": NOW + STEP_S * k, "utc": UTC + STEP_S * k, "echo": None}
        seen = view(**at)
        readings = {name: replace(item, time_s=at["now_s"]) for name, item in seen.readings.items()}
        wanted = Command(heater_duty=float(planned.duty[k]), fan_on=bool(planned.fan[k]))
        verdict = supervise(wanted, replace(seen, readings=readings), memory, safety)
        assert {change.rule for change in verdict.changes} <= {"heater.slew", "heater.step"}
        assert (verdict.sent.heater_duty, verdict.sent.fan_on) == (
            pytest.approx(duty[k]),
            planned.fan[k] == 1.0,
        )
        memory = verdict.memory


@pytest.mark.parametrize(
    ("limits", "kept"),
    [
        (ExperimentLimits(), True),
        (ExperimentLimits(safety=SafetySettings(heater_max_duty=0.0)), False),
        (ExperimentLimits(safety=SafetySettings(heater_max_duty=0.049)), False),  # below the first step
        (ExperimentLimits(safety=SafetySettings(temp_air_max_c=23.0)), False),  # 21 less the margin of 2 K
    ],
)
def test_an_experiment_needs_heat(leak_plan, limits, kept):
    found = design_experiment(leak_plan, limits)
    assert bool(found.profile) is kept
    assert experiment_document(found)["why"]


@pytest.mark.parametrize(("heater_w", "allowed"), [(100.0, True), (400.0, False)])
def test_the_caps_on_energy_count_the_boxs_own_heater(heater_w, allowed):
    limits = ExperimentLimits(SafetySettings(energy_hour_max_wh=60.0), heater_w=heater_w)
    duty = np.full((1, 60), 0.5)  # 50 Wh of 100 W in an hour
    assert limits.within_energy(duty, 60.0).tolist() == [allowed]


def test_a_row_of_the_plan_is_made_of_whole_control_steps():
    assert ExperimentLimits(step_s=60.0).row_s(60.0) == 60.0
    assert ExperimentLimits(step_s=60.0).row_s(10.0) == 60.0
    assert ExperimentLimits(step_s=10.0).row_s(60.0) == 60.0
    assert ExperimentLimits(step_s=45.0).row_s(60.0) == 90.0


def test_the_document_is_one_of_a_diagnosis_and_the_profile_one_of_an_experiment(leak_plan, tmp_path: Path):
    found = design_experiment(leak_plan, ExperimentLimits())
    check_diagnosis({**named_story().document, "next_experiment": experiment_document(found)})
    write_profile(found, tmp_path)
    profile = read_profile(tmp_path / PROFILE)
    assert profile.end_s == found.duration_s
    assert profile.columns["heater_duty"].tolist() == found.profile["heater_duty"].tolist()
    assert profile.columns["heater_duty"][-1] == 0.0
    write_profile(PlannedExperiment(), tmp_path)  # of another diagnosis, in the same folder
    assert not (tmp_path / PROFILE).exists()


def fans_of(plan) -> set[float]:
    """Return what the fan does in any experiment that may be chosen."""
    inputs = candidates(ExperimentLimits(), plan.around, STEP_S)
    return set(inputs.fan[inputs.within])


def test_a_fan_that_does_not_exist_or_has_no_switch_is_never_switched():
    names, blown = ("wall_loss", "infiltration"), [RunInputs(DUTIES, BLOWN)]
    assert fans_of(plan_of(file_of(AIR), driven(LEAKY, NO_FAN), names)) == {0.0, 1.0}
    assert fans_of(plan_of(file_of(AIR), driven(LEAKY, NO_FAN), names, has_fan=False)) == {0.0}
    assert fans_of(plan_of(file_of(AIR), driven(LEAKY, blown), names)) == {1.0}  # it runs in every row
    assert fans_of(plan_of(file_of(AIR), driven(LEAKY, blown), names, has_fan=False)) == {0.0}


@pytest.mark.parametrize(("light", "is_used"), [(None, False), (0.0, False), (0.5, True)])
def test_a_lamp_that_was_never_lit_is_never_switched(light, is_used):
    lit = None if light is None else np.full(len(DUTIES), light)
    runs = driven(BOX, [RunInputs(DUTIES, STILL, lit)])
    names = ("led_gain", "constant_heat") if lit is not None else ("wall_mass", "constant_heat")
    plan = plan_of(file_of(BOX), runs, names)
    assert plan.around.has_light is is_used
    inputs = candidates(ExperimentLimits(), plan.around, STEP_S)
    assert bool(inputs.light.any()) is is_used


def test_an_experiment_begins_where_the_box_rests():
    box = {**BOX, "constant_heat": {"P0": 10.0}}
    plan = plan_of(file_of(BOX), driven(box, NO_FAN), ("constant_heat", "sensor_bias"))
    assert plan.start_c == pytest.approx(ROOM_C + 10.0 / 5.0, abs=0.3)  # P0 / UA


def test_a_rival_of_which_nothing_is_open_is_told_apart_too() -> None:
    known = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 10.0}}
    runs, file = driven({**known, "heater_lag": {"tau_h": 200.0}}, [RunInputs(DUTIES, STILL)]), file_of(known)
    (plain,) = fit_twins([begun(file)], fit_runs(runs), 1)
    assert not plain.free
    late = fitted(file, runs, "heater_lag")
    pairs = pairs_of(("sensor_lag", "heater_lag"))
    plan = separation((plain, late), pairs, surroundings(runs, False), STEP_S)
    assert design_experiment(plan, ExperimentLimits()).profile


# from a diagnosis with rivals to the experiment that tells them apart


@pytest.mark.slow
def test_a_leak_that_still_air_does_not_tell_is_to_be_told_by_the_fan() -> None:
    leak, file = "infiltration", twin_file()
    runs = [simulate({**simulated_runs.BOX, leak: {"F_inf": 0.0015}}, seed, 60, fan=False) for seed in (1, 2)]
    with candidates_only(leak, "longwave_radiation"):
        found = diagnose(file, as_diagnosis_runs(runs), silent, "")
    (effect,) = found.verdict.effects
    assert leak in {effect.name, *effect.alternatives}
    assert effect.alternatives
    limits = ExperimentLimits()
    experiment = next_experiment(found, limits)
    assert experiment is not None
    assert leak in experiment.names
    assert set(experiment.profile["fan_on"]) == {0.0, 1.0}
    assert experiment.expected_log_odds > 3.0
    assert experiment.largest_temp_air_c < limits.safety.temp_air_max_c
    no_fan = replace(found, inputs=replace(found.inputs, file=replace(found.inputs.file, fan_role="none")))
    runs = [replace(item, run=without_fan(item.run)) for item in found.data.train]
    unrecorded = replace(found, data=replace(found.data, train=tuple(runs)))
    for other in (no_fan, unrecorded):
        still = next_experiment(other, limits)
        assert still is not None
        assert set(still.profile.get("fan_on", [0.0])) == {0.0}


def without_fan(run: RecordedRun) -> RecordedRun:
    return replace(run, columns={name: own for name, own in run.columns.items() if name != "fan_on"})
