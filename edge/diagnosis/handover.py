"""Twins judged by rows that no fit saw: the one that is handed over, whether it is possible and worth
adopting.

Each set of effects has values by least squares over free runs. Of those that predict as well as the best the
one with the fewest values is handed over (Breiman et al. 1984, Classification and Regression Trees, ch. 3).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.baselines import ONE_MASS, ORDERS, arx_errors, arx_weights, simple_twins
from edge.diagnosis.candidates import Names
from edge.diagnosis.free_fit import block_sums, fit_values, folds, left_out_errors, rms_k, widen
from edge.diagnosis.prepare import PreparedRuns, errors_over
from edge.diagnosis.progress import Telling
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.unknowns import UnknownValue
from edge.twin.effects.effect import ParameterKind, Values
from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import SDS_95, Value

WATER_J_M3_K = 4.18e6  # nothing that fits into a box stores more heat
LAGS = (ParameterKind.AIR_LAG, ParameterKind.LAG)
PERIODS = 3.0  # of the longest run: a slower time constant can't be seen in it


def impossible(name: str, fitted: FittedTwin, runs: RunBatch, step_s: float) -> list[str]:
    """Return sentences about the impossible values of an effect in this
    greenhouse and in runs of this length.
    """
    values = {key: value.value for key, value in fitted.file.effects.get(name, {}).items()}
    geometry = fitted.file.twin().geometry
    stores = _stores(name, values, geometry.air_capacity_j_k)
    full = WATER_J_M3_K * geometry.volume_m3
    said = [
        f"{key} would store {store / full:.2g} times the heat of the box full of water"
        for key, store in stores.items()
        if store > full
    ]
    longest_s = float(runs.measured.sum(axis=1).max()) * step_s
    for key, tau in _times(name, values).items():
        if tau > PERIODS * longest_s:
            said.append(
                f"a time constant of {tau / 3600.0:.2g} h can't be seen in {longest_s / 3600.0:.2g} h ({key})"
            )
    pairs = zip(fitted.free, map(float, fitted.coordinates), strict=True)
    own = [(item, x) for item, x in pairs if item.place[:2] == ("effects", name)]
    said += [f"{item.place[2]} is as far as it can go" for item, x in own if item.is_at_bound(x)]
    return said


def none_at_all(name: str, fitted: FittedTwin) -> list[str]:
    """Values that may as well be nothing, within their 95 % interval."""
    if len(EFFECTS[name].parameters) > 1:
        return []
    found = []
    for i, item in enumerate(fitted.free):
        if item.place[:2] == ("effects", name) and not item.log:
            x, sd = float(fitted.coordinates[i]), float(np.sqrt(max(fitted.covariance[i, i], 0.0)))
            low, high = item.value(x - SDS_95 * sd), item.value(x + SDS_95 * sd)
            if low <= EFFECTS[name].parameter(item.place[2]).nothing_at <= high:
                found.append(f"{item.place[2]} is {low:.3g} to {high:.3g}, which may as well be no effect")
    return found


def _stores(name: str, values: Values, air_j_k: float) -> dict[str, float]:
    """Heat capacities [J/K] by parameter."""
    found = {}
    for key, value in values.items():
        parameter = EFFECTS[name].parameter(key)
        if parameter.unit == "J/K":
            found[key] = value
        if parameter.kind is ParameterKind.AIR_CAPACITIES:
            found[key] = value * air_j_k
    return found


def _times(name: str, values: Values) -> dict[str, float]:
    """Time constants [s] by parameter or formula."""
    found = {key: value for key, value in values.items() if EFFECTS[name].parameter(key).kind in LAGS}
    if values and (formula := EFFECTS[name].time_constant) is not None:
        found[formula[0]] = formula[1](values)
    return found


Floats = NDArray[np.float64]
MUCH_BETTER = 0.85  # times the error, for what has no name to be added to a twin
OPEN = "~open values"  # among effects: what the file is uncertain of, as if nothing were known of it
NO_WORSE = 1.02  # times the error of free runs without an effect
CLEARLY = 2.0  # standard errors, where it must be no chance that one of several is better


@dataclass(frozen=True, slots=True, eq=False)
class JudgedTwin:
    """A twin judged by rows that its fit did not see.

    added : effects beside those given; errors : [B, N] of free runs over left-out rows [K], NaN where none
    """

    added: Names
    fit: FittedTwin
    errors: Floats

    @property
    def rmse_k(self) -> float:
        """Over all rows that were left out."""
        return rmse(self.errors)

    @property
    def open_values(self) -> list[tuple[UnknownValue, float]]:
        """Fitted unknowns and their coordinates, without values that another effect replaces."""
        return list(zip(self.fit.free, map(float, self.fit.coordinates), strict=True))

    @property
    def at_bound(self) -> list[str]:
        """Values that are as far as they can go."""
        return [".".join(item.place) for item, x in self.open_values if item.is_at_bound(x)]

    @property
    def spreads(self) -> list[tuple[UnknownValue, float, float]]:
        """Fitted unknowns, their coordinates, and the standard deviations of these."""
        sds = np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0))
        return [(own, x, float(sd)) for (own, x), sd in zip(self.open_values, sds, strict=False)]


class ArxBaseline(NamedTuple):
    """weights : of all rows, None of too few; rmse_k : over left-out rows [K]"""

    weights: Floats | None
    rmse_k: float


@dataclass(slots=True, eq=False)
class Comparison:
    """Sets of effects over the same left-out rows, each fitted once. noise_k : of a reading"""

    inputs: PreparedRuns
    noise_k: float
    pool: SideBySide
    telling: Telling
    trials: dict[Names, JudgedTwin] = field(default_factory=dict)
    simple: dict[str, JudgedTwin] = field(default_factory=dict)
    arx: dict[str, ArxBaseline] = field(default_factory=dict)

    def add(self, files: Mapping[Names, TwinFile], below_k: float = np.inf) -> None:
        """Judge sets that were not yet, those alone that miss by less over the rows that are fitted."""
        new = {key: file for key, file in files.items() if key not in self.trials}
        for size in sorted({len(key) for key in new}):
            # One after another, as each begins near a smaller one.
            self._add({key: file for key, file in new.items() if len(key) == size}, below_k)

    def _add(self, new: Mapping[Names, TwinFile], below_k: float) -> None:
        self.telling(f"free runs over left-out rows: {len(new)} twins")
        fitted = self._fit(new.values(), [self._near(key) for key in new])
        kept = [
            (key, item)
            for key, item in zip(new, fitted, strict=True)
            if below_k == np.inf or rms_k(item, self.inputs.runs) < below_k
        ]
        found = self._left_out([item for _, item in kept])
        for (key, _), (item, errors) in zip(kept, found, strict=True):
            self.trials[key] = JudgedTwin(key, item, errors)

    def add_simple(self) -> None:
        """Judge the baselines."""
        runs = self.inputs.runs
        twins = simple_twins(self.inputs.file, runs)
        self.telling("simple models")
        judged = self._left_out(self._fit(twins.values()))
        for name, (fitted, errors) in zip(twins, judged, strict=True):
            self.simple[name] = JudgedTwin(frozenset(), fitted, errors)
        seen = np.isfinite(runs.temp[:, 1:])
        for order in ORDERS:
            errors = np.full(runs.duty.shape, np.nan)
            for fold in folds(runs):
                weights = arx_weights(order, runs, seen & ~fold)
                errors[fold] = arx_errors(weights, runs, seen & ~fold)[fold]
            self.arx[f"ARX {order}"] = ArxBaseline(arx_weights(order, runs, seen), rmse(errors))

    @property
    def simple_k(self) -> dict[str, float]:
        """Errors of the baselines over left-out rows [K]."""
        twins = {name: item.rmse_k for name, item in self.simple.items()}
        return twins | {name: item.rmse_k for name, item in self.arx.items()}

    def choose(self, names: Names) -> JudgedTwin:
        """Choose among twins that contain the standing names: the simplest of
        those that predict as well as the best.

        What has no name is added only where it is clearly better.
        """
        named = self.trials[names]
        most_start_k = NO_WORSE * self.from_start_k(named)
        others = [
            item
            for key, item in self.trials.items()
            if key == names or (key > names and self.is_sound(item, most_start_k))
        ]
        best = min(others, key=lambda item: item.rmse_k)
        if not self.is_better(best, named, CLEARLY):
            return named
        near = [item for item in others if not self.is_better(best, item)]
        return min(near, key=lambda item: (len(item.open_values), item.rmse_k))

    def from_start_k(self, item: JudgedTwin) -> float:
        """Return the RMSE of free runs over the training runs from their first
        rows, hidden states at rest [K].

        A body that may begin anywhere is a heat that no input makes: it helps where what was before is seen,
        and misleads in a run of its own.
        """
        return rmse(errors_over(self.inputs.as_fitted(), item.fit, self.inputs))

    def is_sound(self, item: JudgedTwin, most_start_k: float) -> bool:
        """Return whether its values can be in this greenhouse and its runs from the first rows are near."""
        return not self.is_impossible(item) and self.from_start_k(item) <= most_start_k

    def is_impossible(self, item: JudgedTwin) -> bool:
        """Return whether an added effect has a value that is impossible in this greenhouse."""
        runs, step_s = self.inputs.runs, self.inputs.file.sample_s
        return any(impossible(name, item.fit, runs, step_s) for name in item.added - {OPEN})

    def is_better(self, item: JudgedTwin, than: JudgedTwin, errors: float = 1.0) -> bool:
        """Return whether one twin's free runs miss left-out rows by much less,
        and by `errors` standard errors.
        """
        return item.rmse_k < MUCH_BETTER * than.rmse_k and self.behind(than, item) > errors

    def is_better_throughout(self, item: JudgedTwin, than: JudgedTwin) -> bool:
        """Return whether a twin is clearly better, in all fifths of the runs but one, and at their ends."""
        if not self.is_better(item, than, CLEARLY):
            return False
        parts = folds(self.inputs.runs)
        less = [rmse(item.errors[part]) < rmse(than.errors[part]) for part in parts]
        return less[-1] and sum(less) >= len(parts) - 1

    def behind(self, item: JudgedTwin, best: JudgedTwin) -> float:
        """By how many standard errors one misses more than another, blocks of time taken as independent.

        By the logarithm of what each misses in a block: one that runs away in a single one decides nothing.
        """
        known = np.isfinite(item.errors) & np.isfinite(best.errors)
        least = block_sums(np.where(known, self.noise_k**2, 0.0), self.inputs.runs)
        own, less = (
            block_sums(np.where(known, each.errors**2, 0.0), self.inputs.runs) for each in (item, best)
        )
        told = least > 0.0
        off = np.log((own[told] + least[told]) / (less[told] + least[told]))
        if len(off) < 2:
            return 0.0
        return float(off.mean()) / max(float(off.std(ddof=1)) / float(np.sqrt(len(off))), 1e-12)

    def _near(self, names: Names) -> FittedTwin | None:
        """Return the best judged twin that has all of these effects but one."""
        others = [item for key, item in self.trials.items() if key < names and len(names - key) == 1]
        best = min(others, key=lambda item: item.rmse_k, default=None)
        return None if best is None else best.fit

    def _fit(self, files: Iterable[TwinFile], near: Sequence[FittedTwin | None] = ()) -> list[FittedTwin]:
        rooms = [term for term in self.inputs.terms if term.of_room]
        return fit_values(list(files), rooms, self.inputs.runs, self.noise_k, self.pool, near)

    def _left_out(self, fitted: Sequence[FittedTwin]) -> list[tuple[FittedTwin, Floats]]:
        """With wider intervals, and the errors."""
        runs = self.inputs.runs
        told = left_out_errors(fitted, folds(runs), runs, self.pool)
        return [(widen(item, sds), errors) for item, (errors, sds) in zip(fitted, told, strict=True)]


def free_values(file: TwinFile) -> TwinFile:
    """With uncertain values to be fitted, whatever the file says of them."""
    return file.with_values(
        {place: Value(value.value, fit=True) for place, value in file.values().items() if value.rel_sd}
    )


def rmse(errors: Floats) -> float:
    """Return the RMSE over known errors, infinite if one is infinite [K]."""
    known = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def against_adopting(
    given: JudgedTwin,
    handed: JudgedTwin,
    simple_k: Mapping[str, float],
    test_k: Mapping[str, float],
) -> tuple[str, ...]:
    """Why a twin should not be adopted, sentences; none where it may.

    simple_k : errors of the baselines over left-out rows
    test_k : the same over test runs, where there are any, and those of the twin `before` and `after`
    """
    # `not a < b`, not `a >= b`: an error that is no number speaks against it too.
    own_k = handed.rmse_k
    said = []
    if not own_k < given.rmse_k:
        said.append(
            f"over left-out rows its free runs miss by {own_k:.3g} K, those of the twin as given by "
            f"{given.rmse_k:.3g} K"
        )
    if test_k and not test_k["after"] < test_k["before"]:
        said.append(
            f"over the test runs its free runs miss by {test_k['after']:.3g} K, before by "
            f"{test_k['before']:.3g} K"
        )
    if test_k and not test_k["after"] <= test_k[ONE_MASS]:
        said.append(
            f"over the test runs a single mass misses by {test_k[ONE_MASS]:.3g} K, this twin by "
            f"{test_k['after']:.3g} K"
        )
    if not own_k <= simple_k[ONE_MASS]:
        said.append(
            f"over left-out rows a single mass misses by {simple_k[ONE_MASS]:.3g} K, this twin by "
            f"{own_k:.3g} K"
        )
    if handed.at_bound:
        said.append(f"a value is as far as it can go: {', '.join(handed.at_bound)}")
    return tuple(said)
