"""Which signals the unexplained heat depends on: terms of signals, and the small subset that explains
most.

Regressed are the innovations of the filter that tracks the heat, on what each term's heat would do to them:
whitened by the same filter, so that slow wandering counts for little and rows are independent, and with
regressors from rows before only, so that noise in a reading does not look like a dependence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.candidates import response_to
from edge.diagnosis.locate.residuals import Residuals
from edge.diagnosis.locate.rows import DAY_S, HOUR_S
from edge.twin.effects.signal import vapour_deficit_kpa

Floats = NDArray[np.float64]
SLOW_S = 900.0  # after which a slow signal has followed by 63 %
FEWEST_HOURS, FEWEST_DAYS = 6.0, 1.5  # recorded, before the hour or the day may matter

Heat = Callable[[Residuals], Floats]


class FormulaTerm(NamedTuple):
    """A formula, the signals in it by their public names, and its value in each step, [N]."""

    formula: str
    signals: tuple[str, ...]
    value: Heat

    def times(self, other: "FormulaTerm") -> "FormulaTerm":
        """Return the product of two terms."""
        signals = tuple(dict.fromkeys(self.signals + other.signals))
        return FormulaTerm(
            f"{self.formula} {other.formula}", signals, lambda run: self.value(run) * other.value(run)
        )


DUTY, FAN, AIR, ROOM = "heater_duty", "fan_on", "temp_air", "temp_ambient"
LIGHT, HUMIDITY, TIME = "light", "rel_humidity", "time"
_DUTY = FormulaTerm("u", (DUTY,), lambda run: run.duty)
_FAN = FormulaTerm("u_f", (FAN,), lambda run: run.fan)
_STILL = FormulaTerm("(1 - u_f)", (FAN,), lambda run: 1.0 - run.fan)
_EXCESS = FormulaTerm("(T - T_amb)", (AIR, ROOM), lambda run: run.excess_k)
_AIR = FormulaTerm("T", (AIR,), lambda run: run.air_c)
_LIGHT = FormulaTerm("L", (LIGHT,), lambda run: _known_or_zero(run.light))
_HUMIDITY = FormulaTerm("RH", (HUMIDITY,), lambda run: _known_or_zero(run.rel_humidity) / 100.0)
_DEFICIT = FormulaTerm(
    "VPD", (HUMIDITY, AIR), lambda run: vapour_deficit_kpa(run.air_c, _known_or_zero(run.rel_humidity))
)
ALONE = (
    _DUTY,
    FormulaTerm("u^2", (DUTY,), lambda run: run.duty**2),
    FormulaTerm("slow(u)", (DUTY,), lambda run: _slow(run.duty, run.step_s)),
    _FAN,
    FormulaTerm("slow(u_f)", (FAN,), lambda run: _slow(run.fan, run.step_s)),
    _EXCESS,
    FormulaTerm("(T - T_amb)^2", (AIR, ROOM), lambda run: run.excess_k * np.abs(run.excess_k)),
    FormulaTerm("slow(T)", (AIR,), lambda run: _slow(run.air_c, run.step_s)),
    _AIR,
    FormulaTerm("T_amb", (ROOM,), lambda run: run.ambient),
)


def library(runs: Sequence[Residuals]) -> list[FormulaTerm]:
    """Return the terms that these runs have the columns and the duration for."""
    lit = [_LIGHT] if all(run.light is not None for run in runs) else []
    humid = [_HUMIDITY, _DEFICIT] if all(run.rel_humidity is not None for run in runs) else []
    times = _times(runs)
    factors = [_DUTY, _FAN, _STILL, _EXCESS, _AIR, *lit, *humid, *times]
    products = [a.times(b) for a, b in combinations(factors, 2) if not set(a.signals) & set(b.signals)]
    return [*ALONE, *lit, *humid, *times, *products]


def _times(runs: Sequence[Residuals]) -> list[FormulaTerm]:
    found = [FormulaTerm("t", (TIME,), lambda run: run.time_s / HOUR_S)]
    starts = [run.start_utc for run in runs]
    if any(start is None for start in starts):
        return found
    first = min(start for start in starts if start is not None)
    spans = [(_begin(run) + run.time_s[-1]) for run in runs if len(run.time_s)]
    hours = {int(h) for run in runs for h in ((_begin(run) + run.time_s) % DAY_S) // HOUR_S}
    if len(hours) >= FEWEST_HOURS:
        found.append(FormulaTerm("sin(2 pi h / 24)", (TIME,), lambda run: np.sin(_angle(run))))
        found.append(FormulaTerm("cos(2 pi h / 24)", (TIME,), lambda run: np.cos(_angle(run))))
    if spans and max(spans) - first >= FEWEST_DAYS * DAY_S:
        found.append(FormulaTerm("day", (TIME,), lambda run: (_begin(run) + run.time_s - first) / DAY_S))
    return found


def _angle(run: Residuals) -> Floats:
    return np.asarray(2.0 * np.pi * ((_begin(run) + run.time_s) % DAY_S) / DAY_S)


def _begin(run: Residuals) -> float:
    return 0.0 if run.start_utc is None else run.start_utc


def _known_or_zero(column: Floats | None) -> Floats:
    if column is None:
        raise ValueError("a term of a column that the run does not have")
    return column


def _slow(values: Floats, step_s: float) -> Floats:
    """First-order lag, at rest before the first row."""
    keeps, slow = float(np.exp(-step_s / SLOW_S)), 0.0
    found = np.empty(len(values))
    for k, value in enumerate(values.tolist()):
        slow = keeps * (slow if k else value) + (1.0 - keeps) * value
        found[k] = slow
    return found


BEAM = 12  # subsets of a size that are carried on
LARGEST = 4  # terms


@dataclass(frozen=True, slots=True, eq=False)
class SumRegression:
    """Least squares from sums alone. gram : [p, p]; product : [p], with what is explained; total : its square

    rows : that tell something
    """

    gram: Floats
    product: Floats
    total: float
    rows: int

    @classmethod
    def of(cls, columns: Floats, explained: Floats, rows: int) -> "SumRegression":
        """columns : [R, p], scaled to length 1 so that the criterion does not depend on units."""
        return cls(columns.T @ columns, columns.T @ explained, float(explained @ explained), rows)

    def remainder(self, subset: Sequence[int]) -> float:
        """Sum of squares that a subset leaves."""
        if not subset:
            return self.total
        places = list(subset)
        matrix = self.gram[np.ix_(places, places)] + 1e-9 * np.eye(len(places))
        return max(
            self.total - float(self.product[places] @ np.linalg.solve(matrix, self.product[places])), 1e-12
        )

    def cost(self, subset: Sequence[int], library: int) -> float:
        """Twice the negative log-likelihood, the noise's size fitted, with the price of the terms (EBIC).

        Chen & Chen 2008, Biometrika 95.
        """
        price = np.log(self.rows) + 2.0 * np.log(max(library, 2))
        return float(self.rows * np.log(self.remainder(subset) / self.rows) + len(subset) * price)

    def best(self, allowed: Sequence[int]) -> tuple[int, ...]:
        """Return the subset of `allowed` of least cost, found by a beam over sizes."""
        library = len(self.product)
        beam: list[tuple[int, ...]] = [()]
        winner: tuple[int, ...] = ()
        least = self.cost(winner, library)
        for _ in range(LARGEST):
            grown = {tuple(sorted((*subset, i))) for subset in beam for i in allowed if i not in subset}
            if not grown:
                break
            beam = sorted(grown, key=lambda subset: self.remainder(subset))[:BEAM]
            cost = self.cost(beam[0], library)
            if cost < least:
                winner, least = beam[0], cost
        return winner


FALSE_ALARM = 0.01  # chance of any dependence where there is none
FEWEST_ROWS = 30
FEWEST_PARTS = 8  # that the runs are cut into: a dependence must hold in most of them
CLEAR = 2.5  # standard errors, over those parts
POWER_RUN_SD_W = 1.5  # of a 100 W heater


@dataclass(frozen=True, slots=True)
class Dependence:
    """A signal on which the heat depends.

    strength : share of what the best formula explains that is lost without the signal, 0..1
    p_value : chance that a signal without influence would seem to matter as much, all that were tried counted
    """

    name: str
    strength: float
    p_value: float


@dataclass(frozen=True, slots=True)
class Explanation:
    """The best small formula, as a description and not as physics.

    terms, coefficients_w : formulas and what each is to be multiplied by [W]
    share : of the white innovations' square that it explains
    """

    terms: tuple[str, ...]
    coefficients_w: tuple[float, ...]
    share: float
    depends: tuple[Dependence, ...]


NOTHING = Explanation((), (), 0.0, ())


def depends_on(runs: Sequence[Residuals], power_run_sd_w: float = POWER_RUN_SD_W) -> list[Dependence]:
    """Signals that matter, the strongest first; [] where none does for sure.

    power_run_sd_w : sd of the full heater's power from run to run, which is no dependence [W]
    """
    return list(explain(runs, power_run_sd_w).depends)


def explain(runs: Sequence[Residuals], power_run_sd_w: float = POWER_RUN_SD_W) -> Explanation:
    """Fit the best small formula for the unexplained heat; return it and the signals that it needs."""
    told = sum(int((run.white != 0.0).sum()) for run in runs)
    if told < FEWEST_ROWS:
        return NOTHING
    terms, columns, innovations, sizes = _regressors(runs, power_run_sd_w)
    regression = SumRegression.of(columns, innovations, told)
    chosen = _holding(runs, columns, innovations, regression.best(range(len(terms))))
    if not chosen:
        return NOTHING
    left = regression.remainder(chosen)
    found = []
    for name in {name: None for i in chosen for name in terms[i].signals}:
        # What the best formula without this signal loses: a signal that another can stand for is not needed.
        others = regression.best([i for i in range(len(terms)) if name not in terms[i].signals])
        lost = regression.remainder(others) - left
        chance = _chance(lost, left, told - len(chosen), len(terms))
        if chance < FALSE_ALARM:
            strength = min(max(lost / (regression.total - left), 0.0), 1.0)
            found.append(Dependence(name, float(strength), chance))
    sizes_w = np.linalg.lstsq(columns[:, chosen], innovations, rcond=None)[0] / sizes[list(chosen)]
    return Explanation(
        tuple(terms[i].formula for i in chosen),
        tuple(float(value) for value in sizes_w),
        1.0 - left / regression.total,
        tuple(sorted(found, key=lambda item: -item.strength)),
    )


def _regressors(
    runs: Sequence[Residuals], power_run_sd_w: float
) -> tuple[list[FormulaTerm], Floats, Floats, Floats]:
    """Terms that vary; what they do to the innovations, [R, p], of length 1; the innovations; the lengths.

    Of both what a constant heat would explain is taken out: it depends on nothing.
    """
    terms, parts = library(runs), []
    for run in runs:
        every = [np.nan_to_num(term.value(run)) for term in terms]
        caused = response_to(run.response, np.stack([*every, np.ones_like(run.duty), run.duty], axis=1))
        seen = np.column_stack([caused[:, :-1], run.white])
        parts.append(_without_own_size(seen, power_run_sd_w * caused[:, -1]))
    table = np.concatenate(parts)
    constant, seen = table[:, -2:-1], np.delete(table, -2, axis=1)
    rest = seen - constant @ np.linalg.lstsq(constant, seen, rcond=None)[0]
    columns, sizes = rest[:, :-1], np.linalg.norm(rest[:, :-1], axis=0)
    varies = sizes > 1e-6 * np.maximum(np.linalg.norm(seen[:, :-1], axis=0), 1e-300)
    kept = [term for term, vary in zip(terms, varies, strict=True) if vary]
    return kept, columns[:, varies] / sizes[varies], rest[:, -1], sizes[varies]


def _without_own_size(columns: Floats, own: Floats) -> Floats:
    """Return a run's columns whitened for a size that differs between runs: times (1 + own own')^-1/2."""
    square = float(own @ own)
    if not square > 0.0:
        return columns
    shrink = (1.0 - 1.0 / np.sqrt(1.0 + square)) / square
    return np.asarray(columns - shrink * np.outer(own, own @ columns))


def _holding(
    runs: Sequence[Residuals], columns: Floats, innovations: Floats, chosen: tuple[int, ...]
) -> tuple[int, ...]:
    """Return the terms without which left-out parts of the runs are forecast clearly worse."""
    pieces = max(1, -(-FEWEST_PARTS // len(runs)))
    lengths = [len(part) for run in runs for part in np.array_split(run.white, pieces)]
    part = np.repeat(np.arange(len(lengths)), lengths)
    while chosen:
        whole = _left_out(columns[:, chosen], innovations, part)
        gains = []
        for i in chosen:
            others = [j for j in chosen if j != i]
            gains.append(_clear(_left_out(columns[:, others], innovations, part) - whole))
        weakest = int(np.argmin(gains))
        if gains[weakest] > CLEAR:
            break
        chosen = chosen[:weakest] + chosen[weakest + 1 :]
    return chosen


def _left_out(columns: Floats, innovations: Floats, part: NDArray[np.intp]) -> Floats:
    """Squared error of each part, by a fit on the others."""
    count = int(part.max()) + 1
    found = np.empty(count)
    for i in range(count):
        here = part == i
        sizes = np.linalg.lstsq(columns[~here], innovations[~here], rcond=None)[0]
        found[i] = ((innovations[here] - columns[here] @ sizes) ** 2).sum()
    return found


def _clear(gains: Floats) -> float:
    """How many standard errors the mean is above 0."""
    return float(gains.mean() / max(gains.std(ddof=1) / np.sqrt(len(gains)), 1e-300))


def _chance(lost: float, left: float, freedom: int, tried: int) -> float:
    from scipy.special import fdtrc  # the tail of F; scipy.stats takes a second to load

    return float(min(1.0, tried * fdtrc(1, freedom, max(lost, 0.0) * freedom / left)))
