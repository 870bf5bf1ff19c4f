"""Every kept training scored again on the test runs of its regime, from its weights."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Floats
from training.data.datasets import data_sha256, test_run, training_runs
from training.models.rollout import START_ROWS, RolloutErrors, errors, free_run, one_step
from training.models.saved_training import PAPER, SavedTraining
from training.models.study import SCENARIOS, Regime

TEMP = "temp_air_c"


@dataclass(frozen=True, slots=True)
class TrainingScore:
    """One training on one test run.

    mae_inside_k, mae_outside_k : of the free run where the measured temperature was inside the range of the
        training data and where it was outside; None for no such row
    outside : share of the rows that were outside
    hottest_c, hottest_measured_c : of the free run and of the measurements beside it
    """

    model: str
    regime: Regime
    seed: int
    scenario: int
    free_run: RolloutErrors
    one_step: RolloutErrors
    mae_inside_k: float | None
    mae_outside_k: float | None
    outside: float
    hottest_c: float
    hottest_measured_c: float


@dataclass(frozen=True, slots=True)
class ScoredRun:
    """A score, and the free run [rows - START_ROWS] [°C] that it is of."""

    score: TrainingScore
    forecast: Floats


def score_runs(trainings: Iterable[SavedTraining], scenarios: Sequence[int] | None = None) -> list[ScoredRun]:
    """All of `trainings` on the test runs of their regimes, or on those of them that are in `scenarios`.

    Errors : DataError for a training on other runs than those that are recorded here
    """
    hashes = {regime: data_sha256(training_runs(regime)) for regime in SCENARIOS}
    found = []
    for kept in trainings:
        if kept.record["data_sha256"] != hashes[kept.regime]:
            raise DataError(f"{kept.folder}: data_sha256: trained on other runs than those recorded here")
        numbers = SCENARIOS[kept.regime]
        found += [_score(kept, number) for number in numbers if scenarios is None or number in scenarios]
    return found


@dataclass(frozen=True, slots=True)
class SwappedModel:
    """A model of either regime on the test runs of both: what is the model's, and what is the run's."""

    model: str
    regime: Regime  # that it was trained for
    bias_k: tuple[float, ...]  # of the free runs of scenarios 1 to 6


def swap_models(trainings: Iterable[SavedTraining], model: str) -> list[SwappedModel]:
    """One per training of the model."""
    runs = [test_run(number) for numbers in SCENARIOS.values() for number in numbers]
    return [
        SwappedModel(
            model, kept.regime, tuple(errors(free_run(kept.predictor, run), run).bias_k for run in runs)
        )
        for kept in trainings
        if kept.model == model
    ]


def maes(scores: Iterable[TrainingScore], model: str, regime: Regime) -> Floats:
    """Free-run MAE [seeds, 3] by seed and scenario [K]; [0, 3] where the model wasn't scored."""
    mine = [score for score in scores if score.model == model and score.regime == regime]
    rows = [
        [score.free_run.mae_k for score in mine if score.seed == seed]
        for seed in sorted({score.seed for score in mine})
    ]
    return np.array(rows).reshape(-1, len(SCENARIOS[regime]))


def by_seed(scores: Iterable[TrainingScore], model: str, regime: Regime, seeds: int) -> Floats:
    """Mean free-run MAE of the regime by seed [seeds]; a model without seeds has the same for each [K]."""
    means = maes(scores, model, regime).mean(axis=1)
    if len(means) not in (1, seeds):
        raise DataError(f"{model}, {regime}: {len(means)} seeds of {seeds}")
    return np.broadcast_to(means, (seeds,))


def orders(
    scores: Sequence[TrainingScore], regime: Regime, models: Sequence[str] = PAPER
) -> Counter[tuple[str, ...]]:
    """How many seeds have which order of the models, best first."""
    seeds = max(len(maes(scores, model, regime)) for model in models)
    columns = {model: by_seed(scores, model, regime, seeds) for model in models}
    return Counter(tuple(sorted(models, key=lambda model: columns[model][seed])) for seed in range(seeds))


def _score(kept: SavedTraining, scenario: int) -> ScoredRun:
    run = test_run(scenario)
    forecast = free_run(kept.predictor, run)
    measured = run.columns[TEMP][START_ROWS:]
    low, high = kept.record["validity"][TEMP]
    missed = np.abs(forecast - measured)
    known = np.isfinite(measured)
    outside = known & ((measured < low) | (measured > high))
    score = TrainingScore(
        model=kept.model,
        regime=kept.regime,
        seed=kept.seed,
        scenario=scenario,
        free_run=errors(forecast, run),
        one_step=errors(one_step(kept.predictor, run), run),
        mae_inside_k=_mean(missed[known & ~outside]),
        mae_outside_k=_mean(missed[outside]),
        outside=float(outside.sum() / known.sum()),
        hottest_c=float(forecast.max()),
        hottest_measured_c=float(np.nanmax(measured)),
    )
    return ScoredRun(score, forecast)


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if values.size else None
