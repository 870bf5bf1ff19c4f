"""A short run fitted about a prior, with a heat that nobody knows beside it.

The sun on a box is more than an hour of tests tells of its values: a fit that knows no other heat finds it in
a loss or in a slow mass, and misses by it when the sun is gone. So a coloured heat may act. The run tells
little of its strength: values are means over several, each by its evidence (Bayesian model averaging, Hoeting
et al. 1999, Statistical Science 14; Laplace's approximation).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge.diagnosis.diagnose import fitted_twin
from edge.diagnosis.fitting import fit
from edge.diagnosis.free_fit import FINELY, fit_values
from edge.diagnosis.innovations import NoiseLevels
from edge.diagnosis.noise_levels import first_levels
from edge.diagnosis.nuisances import still_loss_w_k
from edge.diagnosis.prepare import PreparedRuns
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, Trial
from edge.diagnosis.unknowns import place_unknowns, unknowns
from edge.twin.twin_file import TwinFile

# Found on development boxes (docs/measured/fleet.md).
HEATS_K = (0.0, 0.3, 1.0)  # by which an unknown heat may warm the box in the end
UNLIKE_K = 3.0  # a run that so much heat tells far better is of another box
FAR_BETTER_NATS = 3.0  # strong evidence, 20 to 1 (Kass and Raftery 1995, JASA 90)
HEAT_TAU_S = 7200.0  # as the sun moves


def fit_about(prepared: PreparedRuns) -> TwinFile | None:
    """Return the twin with its uncertain values at their best, with intervals and correlations.

    Returns : None where the runs are of a box that the prior is not of
    Errors : DataError for a twin that the runs can't be fitted to
    """
    file, runs = prepared.file, prepared.runs
    rooms = tuple(term for term in prepared.terms if term.of_room)
    noise_k = first_levels(file, runs).sensor_k
    (free,) = fit_values([file], rooms, runs, noise_k, SideBySide())
    loss_w_k = still_loss_w_k(file.twin())
    levels = [_with_heat(free.trial.levels, loss_w_k * heat_k) for heat_k in (*HEATS_K, UNLIKE_K)]
    trials = [Trial(file, own, rooms, unknowns(file)) for own in levels]
    *every, unlike = fit(trials, runs, FINELY)
    likely = max(map(_evidence, every))
    return None if _evidence(unlike) > likely + FAR_BETTER_NATS else fitted_twin(_mean(every))


def _mean(every: Sequence[FittedTwin]) -> FittedTwin:
    """Return the mean of fits of one twin, with a covariance of what each leaves open and how they differ."""
    nats = np.array([_evidence(item) for item in every])
    best = every[int(np.argmax(nats))]
    if not np.isfinite(nats.max()):
        return best
    shares = np.exp(nats - nats.max())
    shares /= shares.sum()
    places = np.array([item.coordinates for item in every])
    mean, size = shares @ places, places.shape[1]
    open_ = np.tensordot(shares, [item.covariance[:size, :size] for item in every], axes=1)
    apart = (places - mean).T @ (shares[:, None] * (places - mean))
    file = place_unknowns(best.file, best.free, mean)
    return replace(best, file=file, coordinates=mean, covariance=open_ + apart)


def _with_heat(levels: NoiseLevels, heat_w: float) -> NoiseLevels:
    return replace(levels, heat_w=heat_w, heat_tau_s=HEAT_TAU_S)


def _evidence(found: FittedTwin) -> float:
    """How likely the run is with all values that the prior allows [nats, up to a constant]."""
    sign, log_volume = np.linalg.slogdet(found.covariance)
    return found.log_likelihood + 0.5 * float(log_volume) if sign > 0.0 else -np.inf
