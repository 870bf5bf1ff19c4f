"""Runs of twins with effects that the twin in question lacks: to see whether they are located."""

import numpy as np

from edge.diagnosis.locate.residuals import residuals_of
from edge.diagnosis.location import whiteness
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest

BASE = {"extra_capacity": {"kC": 10.0}, "wall_loss": {"UA": 4.0}}
NOISE_K = 0.1


def made(effects, count=8, rows=180, seed=0, noise_k=NOISE_K, conditions=None, fan_share=0.3, held=(10, 5)):
    """Runs from rest: duties that hold 10 rows and fans that hold 5, a room that wanders, noise."""
    rng, twin = np.random.default_rng(seed), BoxTwin(effects=effects)
    duty = _kept(rng.choice([0.0, 0.2, 0.4, 0.6], (count, rows)), held[0], rows)
    fan = _kept((rng.uniform(size=(count, rows)) < fan_share).astype(float), held[1], rows)
    room = 21.0 + 0.5 * np.sin(np.arange(rows) / 40.0 + rng.uniform(0.0, 6.0, (count, 1)))
    start = np.stack([at_rest(twin, 22.0, now) for now in room[:, 0]])
    temps = twin.rollout(start, duty, fan, room, conditions=conditions)
    whole = np.concatenate([np.full((count, 1), 22.0), temps], axis=1)
    noise = rng.normal(0.0, noise_k, whole.shape) if noise_k else 0.0
    return RunBatch(whole + noise, duty, fan, room, conditions or {})


def _kept(values, rows_each, rows):
    return np.repeat(values, rows_each, axis=1)[:, :rows]


def names(runs):
    return [f"run_{i}" for i in range(len(runs.temp))]


def located(runs, effects=BASE, noise_k=NOISE_K):
    """Residuals of a twin with these effects alone."""
    return residuals_of(BoxTwin(effects=effects), runs, names(runs), noise_k)


def whiteness_of(run):
    """Return the whiteness of a run's one-step residuals."""
    return whiteness(run.one_step_k / run.innovation_sd, run.step_s)
