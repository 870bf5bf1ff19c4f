"""edge/diagnosis/loose_prior.py: a value that runs move far from its prior is let go, others are held."""

import pytest

from bench.support.simulated_runs import BOX, as_diagnosis_runs, simulate
from edge.diagnosis.loose_prior import loosen
from edge.diagnosis.prepare import prepare
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

SPREAD = 0.1


def loosened(loss_w_k: float) -> TwinFile:
    runs = [simulate(BOX, seed, 120) for seed in (1, 2)]
    start = TwinFile(
        effects={
            "wall_loss": {"UA": Value(loss_w_k, rel_sd=SPREAD)},
            "extra_capacity": {"kC": Value(10.0, rel_sd=SPREAD)},
        }
    )
    return loosen(prepare(start, as_diagnosis_runs(runs, file=start)))


def test_a_value_that_is_far_from_its_prior_is_let_go_and_stays_where_it_was() -> None:
    loss = loosened(2.0).effects["wall_loss"]["UA"]
    # Twice the prior's is ten spreads of 0.1 in the value: by sqrt((4 + 10²) / 5) = 4.6 times wider.
    assert loss.rel_sd == pytest.approx(0.46, rel=0.2)
    assert loss.value == 2.0


def test_values_that_are_near_to_their_priors_are_held() -> None:
    found = loosened(4.05)
    assert found.effects["wall_loss"]["UA"].rel_sd == SPREAD
    assert found.effects["extra_capacity"]["kC"].rel_sd == SPREAD
