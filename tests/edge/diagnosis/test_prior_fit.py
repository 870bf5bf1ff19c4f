"""edge/diagnosis/prior_fit.py: values about a prior, and a heat that nobody knows beside them."""

from dataclasses import replace

import numpy as np
import pytest

from bench.support.simulated_runs import BOX, as_diagnosis_runs, simulate
from edge.diagnosis.prepare import prepare
from edge.diagnosis.prior_fit import fit_about
from edge.formats.run_file import RecordedRun
from edge.twin.draws import CORRELATION, uncertain
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

SPREAD = 0.1


def fit(loss_w_k: float, run: RecordedRun, spread: float = SPREAD) -> TwinFile | None:
    start = TwinFile(
        effects={
            "wall_loss": {"UA": Value(loss_w_k, rel_sd=spread)},
            "extra_capacity": {"kC": Value(10.0, rel_sd=spread)},
        }
    )
    return fit_about(prepare(start, as_diagnosis_runs([run], file=start)))


def fitted(loss_w_k: float, run: RecordedRun) -> TwinFile:
    found = fit(loss_w_k, run)
    assert found is not None
    return found


def test_a_run_moves_the_values_of_its_prior() -> None:
    found = fitted(3.4, simulate(BOX, 1, 120))
    loss = found.effects["wall_loss"]["UA"]
    assert loss.value == pytest.approx(4.0, rel=0.06)
    assert (loss.low or 0.0) < loss.value < (loss.high or 0.0)
    assert not found.to_fit()
    assert {place[1] for place in uncertain(found)} == {"wall_loss", "extra_capacity"}
    assert CORRELATION in found.provenance


def test_a_sun_that_nobody_measured_is_not_all_taken_for_a_smaller_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = simulate(BOX, 1, 60)
    air = run.columns["temp_air_c"]
    # As of a heat that came in with the run and goes on: 1.5 K within half an hour.
    warmed = air + 1.5 * (1.0 - np.exp(-np.arange(len(air)) / 15.0))
    sunny = replace(run, columns={**run.columns, "temp_air_c": warmed})
    found = fitted(4.0, sunny).effects["wall_loss"]["UA"]
    monkeypatch.setattr("edge.diagnosis.prior_fit.HEATS_K", (0.0,))
    by_values_alone = fitted(4.0, sunny).effects["wall_loss"]["UA"]
    assert by_values_alone.value + 0.05 < found.value < 4.0
    assert (found.low or 0.0) < 4.0 < (found.high or 0.0)
    assert (by_values_alone.high or 0.0) < 4.0


def test_a_run_of_another_box_is_not_fitted() -> None:
    run = simulate({**BOX, "wall_loss": {"UA": 1.5}}, 1, 60)
    assert fit(4.0, run, 0.03) is None
    assert fit(1.5, run, 0.03) is not None
    # Here the heat tells it better, but not by much: that is no proof.
    assert fit(1.9, run, 0.03) is not None
