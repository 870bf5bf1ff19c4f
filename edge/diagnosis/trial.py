"""A twin to be fitted with its noise, and what came of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.innovations import NoiseLevels
from edge.diagnosis.unknowns import UnknownValue
from edge.twin.linearise import EnsembleRun, LinearSteps
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SizedTerm:
    """Something of unknown size that acts in proportion to it: heat into the air, or an error of a reading.

    shape : [N, B] for a size of 1, W or K; of_reading, of_room : of the air's or the room's temperature;
    mean, sd : of the size, before the runs are seen
    """

    name: str
    shape: Floats
    sd: float
    of_reading: bool = False
    mean: float = 0.0
    of_room: bool = False

    def response(self, steps: LinearSteps) -> EnsembleRun:
        """Return the term's effect on the temperature where it passes through the twin."""
        if self.of_reading:
            return EnsembleRun(steps, None, None)
        gain = steps.room if self.of_room else steps.heat
        return EnsembleRun(steps, None, gain * self.shape[..., None])


@dataclass(frozen=True, slots=True)
class Trial:
    """A twin to be fitted: its file, its noise, and terms whose sizes are found with it.

    free : what may move, with its priors; None: what the file says of its values
    """

    file: TwinFile
    levels: NoiseLevels
    nuisances: tuple[SizedTerm, ...] = ()
    free: tuple[UnknownValue, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FittedTwin:
    """A trial at its best.

    file : with the values found; free : what moved
    log_likelihood : in nats, priors included, up to a constant of the data
    covariance : [p + q, p + q], of the coordinates and then the sizes of the q nuisances
    innovations : [B, N] in standard deviations, 0 where not measured
    sizes, size_sds : of the nuisances
    """

    trial: Trial
    file: TwinFile
    free: tuple[UnknownValue, ...]
    coordinates: Floats
    log_likelihood: float
    covariance: Floats
    innovations: Floats
    sizes: Floats
    size_sds: Floats


def start_of(twin: BoxTwin, runs: RunBatch) -> Floats:
    """Return the initial states of runs, [B, n]: at rest with the first temperature."""
    return at_rest(twin, runs.temp[:, 0], runs.ambient[:, 0])


def start_spread(twin: BoxTwin, runs: RunBatch) -> Floats:
    """How far (sd) it may be off, [B, n]."""
    return spread(twin, runs.temp[:, 0] - runs.ambient[:, 0])
