"""Tests for white innovations, which a correct model with correct noise leaves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
MOST_LAGS = 20
FEWEST_ROWS = 20  # below, nothing is said
FINENESS = 10  # frequencies between two of the coarse grid, to find the peak's period


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Tests of one run's innovations, or of several runs together; None where the rows are too few.

    rows : measured; lags : of the Ljung-Box test
    ljung_box_p : small where innovations go together in time
    lag1_autocorrelation : -1..1
    strongest_period_s : of the periodogram, two whole periods in the run at least
    false_alarm : chance that white noise of as many rows has so strong a period
    """

    rows: int
    lags: int
    statistic: float
    ljung_box_p: float | None
    lag1_autocorrelation: float | None
    strongest_period_s: float | None
    false_alarm: float | None


def whiteness(values: Floats, step_s: float, fitted: int = 0) -> Whiteness:
    """Test innovations in standard deviations, NaN where not measured. Gaps are left out, not filled.

    Ljung & Box 1978, Biometrika 65, with the number of pairs that there are at each lag; the period by
    the periodogram, its false alarm by Fisher's exact test of the largest ordinate (1929, Proc. R. Soc. A
    125).

    values : [N]; fitted : parameters of the noise model, degrees of freedom that are spent
    """
    seen = np.isfinite(values)
    rows = int(seen.sum())
    if rows < FEWEST_ROWS or not np.ptp(values[seen]) > 0.0:
        return Whiteness(rows, 0, 0.0, None, None, None, None)
    off = np.where(seen, values - values[seen].mean(), 0.0)
    lags = min(MOST_LAGS, rows // 5)
    correlation, pairs = (np.array(column) for column in zip(*_correlations(off, seen, lags), strict=True))
    # Of a run without gaps this is Ljung & Box's n (n + 2) sum r^2 / (n - lag), r over all n rows.
    statistic = float((rows + 2) / rows * (pairs * correlation**2).sum())
    period_s, false_alarm = _strongest(off, step_s)
    chance = _chance(statistic, lags - fitted)
    return Whiteness(rows, lags, statistic, chance, float(correlation[0]), period_s, false_alarm)


def together(parts: Sequence[Whiteness]) -> Whiteness:
    """Combine runs: sum the test statistics, average correlations by rows, take the least likely period."""
    told = [part for part in parts if part.ljung_box_p is not None]
    rows = sum(part.rows for part in told)
    if not told:
        return Whiteness(sum(part.rows for part in parts), 0, 0.0, None, None, None, None)
    statistic, lags = sum(part.statistic for part in told), sum(part.lags for part in told)
    mean = sum(part.rows * (part.lag1_autocorrelation or 0.0) for part in told) / rows
    best = min(told, key=lambda part: 1.0 if part.false_alarm is None else part.false_alarm)
    alarm = None if best.false_alarm is None else min(1.0, len(told) * best.false_alarm)
    return Whiteness(rows, lags, statistic, _chance(statistic, lags), mean, best.strongest_period_s, alarm)


def _correlations(off: Floats, seen: NDArray[np.bool_], lags: int) -> list[tuple[float, int]]:
    """Mean product of the pairs that there are over the variance, and how many, at each lag."""
    variance, found = float((off[seen] ** 2).mean()), []
    for lag in range(1, lags + 1):
        pairs = int((seen[lag:] & seen[:-lag]).sum())
        found.append((float((off[lag:] * off[:-lag]).sum()) / (max(pairs, 1) * variance), pairs))
    return found


def _chance(statistic: float, freedom: int) -> float | None:
    from scipy.special import chdtrc  # a chi square's tail; scipy.stats takes a second to load

    return float(chdtrc(freedom, statistic)) if freedom > 0 else None


def _strongest(off: Floats, step_s: float) -> tuple[float | None, float | None]:
    """off : [N], 0 where nothing was measured"""
    power = np.abs(np.fft.rfft(off, FINENESS * len(off))) ** 2
    # A grid on which white noise has independent ordinates, from two periods in the run on.
    coarse = np.arange(2, len(off) // 2) * FINENESS
    if len(coarse) < 3:
        return None, None
    share = float(power[coarse].max() / power[coarse].sum())
    peak = int(coarse[power[coarse].argmax()])
    near = power[peak - FINENESS : peak + FINENESS + 1]
    sharp = (peak - FINENESS + int(near.argmax())) / (FINENESS * len(off) * step_s)
    return float(1.0 / sharp), float(min(1.0, len(coarse) * (1.0 - share) ** (len(coarse) - 1)))
