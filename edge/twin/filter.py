"""The Kalman filter: a state of n numbers, known as a mean and a covariance, that one sensor shows a part of.

One row is: the model's own step takes the mean on, exactly and also where it is bent; `predict` takes the
covariance on by the step's matrix; `update` corrects both by the reading, if there is one (extended Kalman
filter: Jazwinski 1970, Stochastic Processes and Filtering Theory, ch. 8).

Users: `edge.twin.warm_start` (state from a history), `edge.tick.estimator` (the running rig),
`edge.drift.kalman` (the twin watched), `edge.controllers.mpc_twin` (`MPC-Twin`) and
`edge.diagnosis.locate.heat_filter` (many runs and noise levels). A form of its own is held to this one by
tests: `training.models.twin_step` (torch).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class InnovationGain(NamedTuple):
    """A reading against what was expected of it, before the update, [...] each but `gain` [..., n].

    innovation : measured minus expected, NaN where nothing was measured
    variance : of the innovation, the sensor's included
    gain : what one unit of innovation does to the state, 0 where nothing was measured
    """

    innovation: Floats
    variance: Floats
    gain: Floats


def predict(covariance: Floats, matrix: Floats, noise: Floats) -> Floats:
    """Return the covariance after a step, A P A' + Q, [..., n, n].

    matrix : A, what the step makes of a small difference in the state; noise : Q, of what is not known in it
    """
    after: Floats = matrix @ covariance @ matrix.swapaxes(-1, -2) + noise
    return after


def update(
    mean: Floats,
    covariance: Floats,
    measured: float,
    sensor_variance: float,
    shown: int = 0,
    clip_sd: float | None = None,
) -> tuple[Floats, Floats]:
    """Correct one state by a reading of its element `shown`; return it unchanged where that is not a number.

    mean : [n]; covariance : [n, n]
    sensor_variance : of the reading alone
    clip_sd : an innovation beyond so many standard deviations teaches the last state no more than those
    """
    # Plain floats: an estimate takes up to a thousand rows, and 0-d arrays double the time of each.
    if not math.isfinite(measured):
        return mean, covariance
    innovation, variance = expectation(mean, covariance, measured, sensor_variance, shown)
    gain = covariance[:, shown] / (variance or math.inf)  # no noise at all: nothing is left to learn
    learnt = gain * innovation
    if clip_sd is not None:
        limit = clip_sd * math.sqrt(variance)
        learnt[-1] = gain[-1] * min(max(innovation, -limit), limit)
    return mean + learnt, covariance - gain[:, None] * covariance[shown]


def expectation(
    mean: Floats, covariance: Floats, measured: float, sensor_variance: float, shown: int = 0
) -> tuple[float, float]:
    """Return a reading's innovation and its variance, before the update."""
    return measured - mean.item(shown), covariance.item(shown, shown) + sensor_variance


def weigh(mean: Floats, covariance: Floats, measured: Floats, sensor_variance: float) -> InnovationGain:
    """Weigh readings of the first element of many states.

    mean : [..., n]; covariance : [..., n, n]; measured : broadcast to [...], NaN where missing
    """
    variance = covariance[..., 0, 0] + sensor_variance
    gain = np.where(np.isfinite(measured)[..., None], covariance[..., 0] / variance[..., None], 0.0)
    return InnovationGain(measured - mean[..., 0], variance, gain)


def update_many(mean: Floats, covariance: Floats, found: InnovationGain) -> tuple[Floats, Floats]:
    """Correct many states at once, each as `update` would; those without a reading stay as they are."""
    better = mean + found.gain * np.nan_to_num(found.innovation)[..., None]
    return better, covariance - found.gain[..., :, None] * covariance[..., None, 0, :]


def symmetric(covariance: Floats) -> Floats:
    """Return a covariance without rounding's asymmetry, which would grow in a filter that runs for days."""
    return np.asarray(0.5 * (covariance + covariance.swapaxes(-1, -2)))
