"""Why models err as they do, asked of the training and validation parts alone; no test run is read.

What does a step leave unexplained when the inputs of r are those of the paper's hybrid, and what when more is
known (least squares, so that no training hides it)? How do free runs get better when the same network, as it
stands in the paper's table, corrects a base that holds more physics? What does a fitted twin still lack?
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edge.core.predictor import Floats
from edge.formats.run_file import RecordedRun
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin
from training.data.datasets import training_runs
from training.data.pairs import split_all, stretches
from training.models import ham, pbm
from training.models.predictors import GuardedHamPredictor
from training.models.rollout import START_ROWS, free_run, mean_free_run_mae
from training.models.saved_training import SavedTraining
from training.models.study import Regime

PAST_ROWS = 10  # of duties that the heater's element may still remember
SEEDS = (0, 1, 2)
EXCESS_K = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)
BASES: Mapping[str, tuple[str, ...]] = {  # what the hybrid corrects; each adds to the one before
    "the paper's PBM": (),
    "+ capacity, wall loss, fan": pbm.ONE_MASS.effects,
    "+ lag of the heater's element": (*pbm.ONE_MASS.effects, "heater_lag"),
    "+ walls that store heat": pbm.FITTED.effects,
}


@dataclass(frozen=True, slots=True)
class UnexplainedError:
    """Root mean square of what is left of a step's temperature, on the validation parts [K].

    With the fan on the paper's T_hat is the air that the fan brings and the heat that it takes along: it
    tells of the room, the heater and 5e-4 of the air's temperature. With the fan off it tells all of it.
    """

    known: str
    fan_off_k: float
    fan_on_k: float


@dataclass(frozen=True, slots=True)
class Base:
    """A base on the validation parts, free run of each, alone and corrected [K]."""

    name: str
    states: int
    alone_mae_k: float
    hybrid_mae_k: tuple[float, ...]  # by seed


@dataclass(frozen=True, slots=True)
class ByExcess:
    """Bias of a model's free runs over the training runs, by how far the air was over the room [K].

    bias_k : one for each step of EXCESS_K
    """

    regime: Regime  # that the model was trained for
    bias_k: tuple[float, ...]


def by_excess(trainings: Iterable[SavedTraining], model: str) -> list[ByExcess]:
    """One per training of the model, over the training runs of all regimes."""
    runs = training_runs("interpolation")
    measured = np.concatenate([run.columns["temp_air_c"][START_ROWS:] for run in runs])
    excess = measured - np.concatenate([run.columns["temp_ambient_c"][START_ROWS:] for run in runs])
    found = []
    for kept in trainings:
        if kept.model == model:
            missed = np.concatenate([free_run(kept.predictor, run) for run in runs]) - measured
            pairs = itertools.pairwise(EXCESS_K)
            steps = (missed[(excess >= low) & (excess < high)] for low, high in pairs)
            found.append(ByExcess(kept.regime, tuple(float(np.nanmean(step)) for step in steps)))
    return found


def unexplained_errors() -> list[UnexplainedError]:
    """One row per set of features, each holding the one before."""
    parts = split_all(training_runs("interpolation"))
    train, validate = (_rows(part) for part in (parts.train, parts.validate))
    sets = {
        "room, heater": ("ambient", "duty"),
        "+ the air's temperature": ("ambient", "duty", "temp"),
        f"+ the last {PAST_ROWS} duties": ("ambient", "duty", "temp", "past"),
    }
    return [
        UnexplainedError(name, *(_remainder(train, validate, names, fan) for fan in (0.0, 1.0)))
        for name, names in sets.items()
    ]


def bases(seeds: Sequence[int] = SEEDS) -> list[Base]:
    """Return the ladder of `BASES`, each fitted on the training parts."""
    runs = training_runs("interpolation")
    validate = [part for part in split_all(runs).validate if len(part) > START_ROWS]
    found = []
    for name, effects in BASES.items():
        twin = pbm.train(runs, pbm.PbmSettings(effects=effects)).twin()
        hybrids = tuple(
            mean_free_run_mae(GuardedHamPredictor(_hybrid(runs, twin, seed)), validate) for seed in seeds
        )
        found.append(Base(name, len(twin.states), mean_free_run_mae(Pbm(twin), validate), hybrids))
    return found


def _hybrid(runs: Sequence[RecordedRun], twin: BoxTwin, seed: int) -> ham.GuardedHamNet:
    network, _ = ham.train_guarded(runs, twin, seed, ham.GuardedHamSettings())
    return network


def _rows(runs: Sequence[RecordedRun]) -> dict[str, Floats]:
    """Return steps with PAST_ROWS known duties before them, by column;
    `past` [n, PAST_ROWS], the others [n].
    """
    found: dict[str, list[Floats]] = {}
    for temp, ambient, duty, fan in stretches(runs):
        now = slice(PAST_ROWS, -1)
        columns = {
            "temp": temp[now],
            "ambient": ambient[now],
            "duty": duty[now],
            "fan": fan[now],
            "past": np.stack([duty[PAST_ROWS - lag : -1 - lag] for lag in range(1, PAST_ROWS + 1)], axis=-1),
            "following": temp[PAST_ROWS + 1 :],
        }
        for name, values in columns.items():
            found.setdefault(name, []).append(values)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _remainder(
    train: Mapping[str, Floats], validate: Mapping[str, Floats], names: Sequence[str], fan: float
) -> float:
    """RMS of the validation parts' residual of a regression on `names`, among steps with this fan state."""

    def regressors(rows: Mapping[str, Floats]) -> tuple[Floats, Floats]:
        here = rows["fan"] == fan
        table = np.column_stack([rows[name][here] for name in names] + [np.ones(here.sum())])
        return table, rows["following"][here]

    table, following = regressors(train)
    solution = np.linalg.lstsq(table, following, rcond=None)[0]
    table, following = regressors(validate)
    return float(np.sqrt(np.mean((table @ solution - following) ** 2)))
