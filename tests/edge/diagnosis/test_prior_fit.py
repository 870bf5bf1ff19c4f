"""edge/diagnosis/prior_fit.py: values about a prior, and a reading that drifts from what the twin says."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis import prior_fit
from edge.diagnosis.diagnose import fitted_twin
from edge.diagnosis.prepare import prepare
from edge.diagnosis.prior_fit import MOST_TERMS, drifts, fit_about
from edge.formats.run_file import RecordedRun
from edge.twin.draws import CORRELATION, uncertain
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import BOX, as_diagnosis_runs, simulate

SPREAD = 0.1
MISSES_K = (0.0, 0.3, 1.0)


def fitted(loss_w_k: float, run: RecordedRun, miss_k: float = 0.3) -> TwinFile:
    start = TwinFile(
        effects={
            "wall_loss": {"UA": Value(loss_w_k, rel_sd=SPREAD)},
            "extra_capacity": {"kC": Value(10.0, rel_sd=SPREAD)},
        }
    )
    return fitted_twin(fit_about(prepare(start, as_diagnosis_runs([run], file=start)), miss_k))


def test_a_run_moves_the_values_of_its_prior() -> None:
    found = fitted(3.4, simulate(BOX, 1, 120))
    loss = found.effects["wall_loss"]["UA"]
    assert loss.value == pytest.approx(4.0, rel=0.06)
    assert (loss.low or 0.0) < loss.value < (loss.high or 0.0)
    assert not found.to_fit()
    assert {place[1] for place in uncertain(found)} == {"wall_loss", "extra_capacity"}
    assert CORRELATION in found.provenance


def sunny_run() -> RecordedRun:
    """Return an hour with a heat that came in with the run and goes on: 1.5 K within half an hour."""
    run = simulate(BOX, 1, 60)
    air = run.columns["temp_air_c"]
    warmed = air + 1.5 * (1.0 - np.exp(-np.arange(len(air)) / 15.0))
    return replace(run, columns={**run.columns, "temp_air_c": warmed})


@pytest.mark.parametrize("miss_k", MISSES_K)
def test_a_sun_that_nobody_measured_is_not_taken_for_a_smaller_loss(miss_k: float) -> None:
    loss = fitted(4.0, sunny_run(), miss_k).effects["wall_loss"]["UA"]
    assert loss.value > 3.65
    assert (loss.low or 0.0) < 4.0 < (loss.high or 0.0)


def test_only_a_run_that_is_missed_by_more_than_usual_counts_less(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = simulate(BOX, 1, 60)
    doubted, usual = fitted(4.0, sunny_run()), fitted(3.4, plain)
    monkeypatch.setattr(prior_fit, "DOUBT", 0.0)
    loss = fitted(4.0, sunny_run()).effects["wall_loss"]["UA"]
    assert (loss.high or 0.0) < 4.0 and loss.value + 0.1 < doubted.effects["wall_loss"]["UA"].value
    assert fitted(3.4, plain) == usual


def test_a_value_far_from_its_kind_is_held_to_it_less(monkeypatch: pytest.MonkeyPatch) -> None:
    run = simulate({**BOX, "wall_loss": {"UA": 1.5}}, 1, 60)
    own = fitted(4.0, run, 1.0)
    assert own.effects["wall_loss"]["UA"].value == pytest.approx(1.5, rel=0.15)
    assert own.effects["extra_capacity"]["kC"].value == pytest.approx(10.0, rel=0.1)
    monkeypatch.setattr(prior_fit, "TAILS", 1e9)  # a normal prior
    assert fitted(4.0, run, 1.0).effects["wall_loss"]["UA"].value > own.effects["wall_loss"]["UA"].value + 0.2


@pytest.mark.parametrize("miss_k", [0.0, 1e3])
def test_any_miss_that_a_fleet_may_tell_leaves_a_twin(miss_k: float) -> None:
    loss = fitted(3.4, simulate(BOX, 1, 60), miss_k).effects["wall_loss"]["UA"]
    assert 3.3 < loss.value < 4.2


def test_drifts_go_together_over_minutes_in_one_run_alone() -> None:
    first, second = (
        np.sum([np.outer(term.shape[:, run], term.shape[:, run]) for term in drifts((2, 360), 10.0, 0.5)], 0)
        for run in (0, 1)
    )
    np.testing.assert_allclose(first, second, atol=1e-12)
    assert first[100, 100] == pytest.approx(0.25, rel=0.1)
    assert first[100, 160] == pytest.approx(0.25 / np.e, rel=0.1)
    assert all(np.any(term.shape, axis=0).sum() == 1 for term in drifts((2, 360), 10.0, 0.5))


def test_tests_of_a_day_have_no_more_drifts_than_those_of_hours() -> None:
    drift = drifts((1, 8640), 10.0, 0.5)
    assert len(drift) == MOST_TERMS
    assert drift[0].shape.shape == (8640, 1)
