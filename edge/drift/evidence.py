"""A sequential test of whitened innovations: has their mean moved, and since when?

For each regime and each size of a shift a Shiryaev-Roberts sum R = (R + 1) L runs over the regime's ticks, L
being the likelihood ratio of the shifted mean against one at the edge of what is allowed. If each innovation,
given all before it, has variance 1, normal or lighter tails and a mean within `ALLOWED`, then E[L] <= 1 and
the weighted sum of all R less the number of ticks is a supermartingale: with the threshold at A the mean time
to a false alarm is at least A ticks, whatever the regimes do (Pollak 1985, Annals of Statistics 13(1); Shin,
Ramdas & Rinaldo 2023, "E-detectors"). Innovations are cut at `CUT` first, which only lowers E[L]: one wild
tick proves nothing, and no event shorter than about ten ticks raises an alarm. Beside each R a CUSUM of the
same ratios (Page 1954, Biometrika 41) dates the change: its last time at 0.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.drift.regimes import REGIMES

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
ALLOWED = 0.25  # a mean so far off is no disagreement [sd]
CUT = 2.0  # [sd]
SIZES = np.array([-1.5, -1.0, -0.5, 0.5, 1.0, 1.5])  # of shifts beyond what is allowed [sd]
COUNT = len(REGIMES) * len(SIZES)
CLEAR = float(np.log(100.0))  # agreement is told when the evidence is a hundredth of the threshold
_ROOM = 1.0  # above the threshold, for one sum; more would take long to come down


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Sums as logarithms, each [*paths, regimes, sizes]."""

    log_sum: Floats
    cusum: Floats
    since_utc: Floats  # when each CUSUM last left 0

    @classmethod
    def none(cls, utc: float, paths: tuple[int, ...] = ()) -> "Evidence":
        """At the start."""
        shape = (*paths, len(REGIMES), len(SIZES))
        return cls(np.full(shape, -np.inf), np.zeros(shape), np.full(shape, utc))

    @property
    def total(self) -> Floats:
        """Logarithm of the weighted sum, [*paths]; to be compared with `log_threshold`."""
        found: Floats = np.logaddexp.reduce(self.log_sum, axis=(-2, -1)) - np.log(COUNT)
        return found


def log_threshold(false_alarm_days: float, step_s: float) -> float:
    """For one false alarm in so many days of ticks at most, on average."""
    return float(np.log(false_alarm_days * 86400.0 / step_s))


def hear(evidence: Evidence, white: Floats, regimes: Flags, start_utc: float, threshold: float) -> Evidence:
    """Return the evidence with one more innovation.

    white : [*paths]; regimes : [regimes], those of the step before it
    start_utc : begin of that step
    threshold : as `log_threshold`: no sum goes far above it
    """
    cut = np.clip(white, -CUT, CUT)[..., None, None]
    log_ratio = SIZES * cut - np.abs(SIZES) * ALLOWED - SIZES**2 / 2.0
    here = regimes[:, None]
    ceiling = threshold + np.log(COUNT) + _ROOM
    log_sum = np.minimum(np.logaddexp(evidence.log_sum, 0.0) + log_ratio, ceiling)
    fresh = here & (evidence.cusum <= 0.0)
    return replace(
        evidence,
        log_sum=np.where(here, log_sum, evidence.log_sum),
        cusum=np.where(here, np.maximum(evidence.cusum + log_ratio, 0.0), evidence.cusum),
        since_utc=np.where(fresh, start_utc, evidence.since_utc),
    )


def change_utc(evidence: Evidence) -> float:
    """When the mean moved, as the strongest part of the evidence has it; of one path."""
    # The CUSUM ranks the parts: the sums stop at their ceiling.
    return float(evidence.since_utc.flat[int(np.argmax(evidence.cusum))])


def by_regime(evidence: Evidence) -> Floats:
    """Return the strongest evidence in each regime of one path, [regimes]."""
    strongest: Floats = evidence.cusum.max(axis=-1)
    return strongest
