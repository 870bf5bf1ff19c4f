"""From a diagnosis with rivals to the experiment that tells them apart."""

import pytest

from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.experiment.design import next_experiment
from edge.diagnosis.experiment.sequence import ExperimentLimits
from tests.support.simulated_runs import BOX, as_diagnosis_runs, silent, simulate, twin_file

pytestmark = pytest.mark.slow
LEAK = "infiltration"


def test_a_leak_that_still_air_does_not_tell_is_to_be_told_by_the_fan() -> None:
    runs = [simulate({**BOX, LEAK: {"F_inf": 0.0015}}, seed, 120, fan=False) for seed in (1, 2)]
    found = diagnose(twin_file(), as_diagnosis_runs(runs), silent, "")
    (effect,) = found.verdict.effects
    assert LEAK in {effect.name, *effect.alternatives}
    assert effect.alternatives
    limits = ExperimentLimits()
    experiment = next_experiment(found, limits)
    assert experiment is not None
    assert LEAK in experiment.names
    assert len({row.fan_on for row in experiment.profile}) == 2
    assert experiment.expected_log_odds > 3.0
    assert experiment.largest_temp_air_c < limits.safety.temp_air_max_c
