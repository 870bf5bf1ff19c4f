"""Disagreement of the twin before anything is added and afterwards: whiteness tests, and sentences about
it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnose import Diagnosis, Side
from edge.diagnosis.diagnosis_document import EventEntry, RegimeAfterEntry, RegimeEntry, WhitenessEntry
from edge.diagnosis.locate.regimes import DisagreementRegime, regimes
from edge.diagnosis.locate.residuals import Residuals, residuals_of
from edge.diagnosis.locate.stretches import Stretch, stretches

Floats = NDArray[np.float64]
MOST_LAGS = 20
FEWEST_ROWS = 20  # below, nothing is said
FINENESS = 10  # frequencies between two of the coarse grid, to find the peak's period


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Tests of one run's innovations; None where the rows are too few.

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


CLEAR = 2.0  # standard errors from 0 that a heat must be before it is given a direction


def regime_sentence(regime: DisagreementRegime) -> str:
    """Such as `71 % of the squared error lies where the fan is off; there the model gains 38 ± 3 W too much`.

    The share of the rows stands beside that of the error.
    """
    share = f"{percent(regime.share_of_squared_error)} of the squared error lies {_where(regime.where)}"
    rows = f"({percent(regime.share_of_rows)} of the rows)"
    if abs(regime.heat_w) < CLEAR * regime.heat_w_se:
        heat = (
            f"the residual heat averages {with_error(regime.heat_w, regime.heat_w_se)} W: no clear direction"
        )
        return f"{share} {rows}; there {heat}"
    direction = "too much" if regime.heat_w < 0.0 else "too little"
    heat = with_error(abs(regime.heat_w), regime.heat_w_se)
    return f"{share} {rows}; there the model gains {heat} W {direction}"


def stretch_sentence(stretch: Stretch) -> str:
    """Such as `19 % of the squared error lies in run_3 from 30 to 55 min, where it is 2.1 K`."""
    begin, end = stretch.from_s / 60.0, stretch.to_s / 60.0
    return (
        f"{percent(stretch.share)} of the squared error lies in {stretch.run} "
        f"from {begin:.0f} to {end:.0f} min, where the free run is off by {stretch.rmse_k:.2g} K"
    )


def findings(regimes: Sequence[DisagreementRegime], stretches: Sequence[Stretch]) -> list[str]:
    """All sentences, strongest first; one that says so where nothing stands out."""
    told = [regime_sentence(item) for item in regimes] + [stretch_sentence(item) for item in stretches]
    return told or ["The squared error is spread evenly: no regime and no time has more than its share"]


def percent(share: float) -> str:
    """In whole percent, but neither 0 nor 100 where it is not."""
    if 0.0 < share < 0.005:
        return "less than 1 %"
    if 0.995 < share < 1.0:
        return "more than 99 %"
    return f"{100.0 * share:.0f} %"


def with_error(value: float, error: float) -> str:
    """`38 ± 3`: the error to one digit (two if it begins with 1), the value as far as that."""
    if not error > 0.0:
        return f"{value:.3g}"
    place = floor(log10(error))
    if round(error / 10.0**place, 1) < 2.0:
        place -= 1
    elif round(error / 10.0**place) == 10:
        place += 1
    digits = max(0, -place)
    return f"{round(value, -place):.{digits}f} ± {round(error, -place):.{digits}f}"


def _where(where: str) -> str:
    return where if where.startswith(("in ", "on ", "between ", "from ")) else f"where {where}"


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """In the form of diagnosis.json.

    before, after : residuals by run name, none where a twin is too far off
    """

    regimes: list[RegimeEntry] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    events: list[EventEntry] = field(default_factory=list)
    before: Mapping[str, Residuals] = field(default_factory=dict)
    after: Mapping[str, Residuals] = field(default_factory=dict)

    white_before: Mapping[str, Floats] = field(default_factory=dict)
    white_after: Mapping[str, Floats] = field(default_factory=dict)
    step_s: float = 60.0

    def whiteness(self, when: str) -> dict[str, WhitenessEntry]:
        """Test the innovations `before` or `after`, by run."""
        runs = self.white_before if when == "before" else self.white_after
        return {name: _whiteness(values, self.step_s) for name, values in runs.items()}

    def series(self, name: str) -> dict[str, Floats]:
        """Residual heat and innovations of a run, for the report."""
        found = {}
        for when, runs, white in (
            ("before", self.before, self.white_before),
            ("after", self.after, self.white_after),
        ):
            if name in runs:
                found[f"residual_heat_{when}_w"] = runs[name].heat_w
            if name in white:
                found[f"innovations_{when}"] = white[name]
        return found


def locate(found: Diagnosis) -> Location:
    """By the residual heat of the training runs."""
    before = _residuals(found, found.before)
    after = _residuals(found, found.after)
    places = regimes(list(before.values())) if before else []
    times = stretches(list(before.values())) if before else []
    listed: list[RegimeEntry] = []
    # A share's lower end falls below 0 by its own error; a reader would take that for a mistake.
    for place in places:
        rows: RegimeEntry = {
            "where": place.where,
            "share_of_squared_error": place.share_of_squared_error,
            "heat_w": place.heat_w,
            "heat_w_se": place.heat_w_se,
            "share_low": max(place.share_low, 0.0),
            "share_high": place.share_high,
            "share_of_rows": place.share_of_rows,
            "rmse_k": place.rmse_k,
        }
        listed.append({**rows, **_afterwards(place.masks, list(before), after)})
    return Location(
        listed,
        findings(places, times),
        _events(found),
        before,
        after,
        _innovations(before),
        _innovations(after),
        found.inputs.file.sample_s,
    )


def _innovations(every: Mapping[str, Residuals]) -> dict[str, Floats]:
    """In standard deviations, by run, NaN where nothing was measured."""
    return {name: item.one_step_k / item.innovation_sd for name, item in every.items()}


def _afterwards(
    masks: tuple[NDArray[np.bool_], ...], names: list[str], after: Mapping[str, Residuals]
) -> RegimeAfterEntry:
    """Return the error of the new twin over the same rows."""
    if not after:
        return {}
    pairs = [(mask, after[name]) for mask, name in zip(masks, names, strict=True)]
    free = np.concatenate([item.free_run_k[mask] for mask, item in pairs])
    heat = np.concatenate([item.heat_w[mask] for mask, item in pairs])
    free, heat = free[np.isfinite(free)], heat[np.isfinite(heat)]
    if not len(free) or not len(heat):
        return {}
    return {"rmse_after_k": float(np.sqrt(np.mean(free**2))), "heat_after_w": float(np.mean(heat))}


def _residuals(found: Diagnosis, side: Side) -> dict[str, Residuals]:
    """By run; none of a twin that is so far off that its filter has no sense."""
    known = found.inputs
    runs = known.with_rooms(side.fit.starts)
    try:
        every = residuals_of(side.fit.file.twin(), runs, known.names, known.noise_k)
    except (DataError, np.linalg.LinAlgError):
        return {}
    return {item.name: item for item in every if np.isfinite(item.heat_w).any()}


def _events(found: Diagnosis) -> list[EventEntry]:
    return [
        {"run": door.run, "from_s": door.from_s, "to_s": door.to_s, "kind": "door", "heat_w": door.heat_w}
        for door in found.doors
    ]


def _whiteness(values: Floats, step_s: float) -> WhitenessEntry:
    found = whiteness(values, step_s)
    return {
        "ljung_box_p": found.ljung_box_p,
        "lag1_autocorrelation": found.lag1_autocorrelation,
        "strongest_period_s": found.strongest_period_s,
    }
