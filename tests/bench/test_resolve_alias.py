"""An alias class resolved by its own experiment, on the independent chamber without a board in between.

`python -m bench.resolve_alias` does the same through the daemon, its safety and the command line.
"""

import numpy as np
from designed import as_inputs

from bench.hidden_effects.case_files import Sensing, read_temps, run_of
from bench.hidden_effects.chamber_box import LEAD_ROWS, RunPlan, drive
from bench.resolve_alias import CASES, AliasCase, Columns, twin_of
from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.diagnosis.experiment.design import next_experiment
from edge.diagnosis.experiment.sequence import ExperimentLimits
from edge.diagnosis.runs import diagnosis_runs
from edge.twin.twin_file import TwinFile
from tests.support.simulated_runs import silent

SENSING = Sensing(noise_k=0.06, step_k=0.1)


def recorded(case: AliasCase, profile: Columns, seed: int):
    """A run of the box with what is hidden in it, as its sensors show it."""
    before = np.zeros(LEAD_ROWS)
    duty, fan = (np.concatenate([before, column]) for column in profile)
    plan = RunPlan(duty, fan, np.zeros(len(duty)), day=0.1 * seed, hour=10.0, room_c=21.2, seed=seed)
    found = drive({**case.box, **case.settings}, plan)
    columns = {
        "temp_air_c": read_temps(np.random.default_rng(seed), found.clean_c, SENSING, "train"),
        "temp_ambient_c": found.shown["temp_ambient_c"],
        "heater_duty": profile[0],
        "fan_on": profile[1],
    }
    return f"run_{seed}.csv", run_of(columns, "train", plan.day, plan.hour)


def diagnosed(file: TwinFile, runs: list) -> Diagnosis:
    return diagnose(file, diagnosis_runs(runs, [], file), silent, "")


def named(found: Diagnosis) -> list[set[str]]:
    """Return the class of each effect that was named."""
    return [{effect.name, *effect.alternatives} for effect in found.verdict.effects]


def test_the_proposed_experiment_leaves_the_true_effect_alone():
    case = CASES["heater_saturation"]
    file = twin_of(case)
    runs = [recorded(case, case.profile, seed) for seed in case.seeds[:2]]
    before = diagnosed(file, runs)
    (rivals,) = named(before)
    assert case.hidden in rivals
    assert len(rivals) > 1
    experiment = next_experiment(before, ExperimentLimits())
    assert experiment is not None
    assert case.hidden in experiment.names
    assert experiment.expected_log_odds > 3.0
    planned = as_inputs(experiment)
    later = recorded(case, (planned.duty, planned.fan), case.seeds[-1])
    assert np.nanmax(later[1].columns["temp_air_c"]) < ExperimentLimits().safety.temp_air_max_c
    assert named(diagnosed(file, [*runs, later])) == [{case.hidden}]
