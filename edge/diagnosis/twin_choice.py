"""Which effects a twin lacks: grown effect by effect by the free runs over rows that no fit saw."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.noise import LEAST_K
from edge.diagnosis.twin_fit import Begun, FitRuns, FittedTwin, Mask, begun, fit_twins, left_out_errors
from edge.diagnosis.unknowns import with_effect
from edge.twin.effects.effect import BlindRuns, Offer, ParameterKind
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Names = frozenset[str]
FIRST_ROWS = 10  # of a run that does not begin at rest, by which its start is told
WHOLE_RUNS = 3  # from so many on, whole runs are left out
FOLDS = 6
SPLITS = (0.4, 0.55, 0.7, 0.85, 1.0)  # of fewer runs: each part forecast from all before it
BLOCKS = 20  # of all left-out rows
MOST_ADDED = 4
# Standard errors, as the best of some twenty candidates is better by chance; and a logarithm: 3 % of an error
# convince no one of an effect.
CLEARLY, MATTERS = 2.0, 0.03
PAYS = 1.02  # times the error over fitted rows, that an effect must take away from these too
AS_CLOSE = 1.2  # times the least error of a fit: where left-out rows tell too little, one that fits
ROUGHLY, FINELY, AGAIN = 3, 50, 4  # iterations
OPEN = "~open values"  # among effects: what the file is uncertain of, as if nothing were known of it
EXPLAINED, MUCH, MOST_UNNAMED = 2.0, 0.15, 2  # times a reading's noise; a logarithm that a nameless heat pays
RUNNERS_UP = 3
LAGS = (ParameterKind.AIR_LAG, ParameterKind.LAG, ParameterKind.DEAD_TIME)
SLOWEST_RUNS = 3.0  # of the longest: a slower body is one that never changes, which is another effect
# Of a logistic regression over names in chosen twins of development cases (`python -m bench.name_map`).
INTERCEPT, SLOPES = -1.4, (0.05, 1.5, 1.3)
CLEAREST, LARGEST = 10.0, 1.5  # of evidence; more of it makes a name no surer
LOOKED_AT = 4  # of what a step along the slopes promises most


def features(more: float, error: float, fitted: float) -> tuple[float, float, float]:
    """Numbers that tell how likely it is that a twin is better for what it has more, for SLOPES.

    more, error : logarithm of what left-out rows are missed more without it, and its standard error
    fitted : the same of fitted rows
    """
    return min(more / max(error, 1e-6), CLEAREST), min(more, LARGEST), min(fitted, LARGEST)


def log_odds(more: float, error: float, fitted: float) -> float:
    """Return the log odds that a twin is better for what it has more."""
    return INTERCEPT + float(np.dot(SLOPES, features(more, error, fitted)))


@dataclass(frozen=True, slots=True, eq=False)
class TriedTwin:
    """A twin fitted to all rows.

    left_out : mean squares of its errors over left-out rows, block by block [K²]; parts : the fold of each
    """

    added: Names
    fit: FittedTwin
    left_out: Floats
    parts: Indices

    @property
    def left_out_k(self) -> float:
        """RMS error over left-out rows [K]."""
        return float(np.sqrt(np.mean(self.left_out)))

    def behind(self, best: "TriedTwin", noise_k: float) -> tuple[float, float]:
        """Return how much more it misses than another, as a logarithm, and the standard error of that."""
        more = 0.5 * np.log((self.left_out + noise_k**2) / (best.left_out + noise_k**2))
        # Blocks of one fold share its fit, so that what they say together may be said once.
        folds = np.array([more[self.parts == part].mean() for part in np.unique(self.parts)])
        errors = [each.std(ddof=1) / np.sqrt(len(each)) for each in (more, folds) if len(each) > 1]
        return float(more.mean()), float(max(errors, default=np.inf))


@dataclass(slots=True, eq=False)
class TwinChoice:
    """Twins over the same rows, each set of effects fitted once."""

    file: TwinFile
    runs: FitRuns
    candidates: Sequence[str]
    tell: Callable[[str], None] = lambda text: None
    tried: dict[Names, TriedTwin] = field(default_factory=dict)
    screened: dict[Names, tuple[FittedTwin, float]] = field(default_factory=dict)

    @property
    def noise_k(self) -> float:
        """Noise of a reading [K]: at most what a fitted twin misses."""
        least_k = min(item.fit.rmse_k for item in self.tried.values())
        return max(min(self.runs.noise_k, least_k), LEAST_K)

    def attempt(self, starts: Iterable[tuple[Names, Begun | FittedTwin]]) -> None:
        """Fit sets that were not yet, and forecast left-out rows; of several starts the best one is kept."""
        new = [(names, start) for names, start in starts if names not in self.tried]
        if not new:
            return
        fits = fit_twins([start for _, start in new], self.runs, FINELY)
        folds = folds_of(self.runs)
        found = zip(new, fits, left_out_errors(fits, folds, self.runs, AGAIN), strict=True)
        for (names, _), fit, errors in found:
            item = TriedTwin(names, fit, *block_squares(errors, folds))
            if names not in self.tried or item.left_out_k < self.tried[names].left_out_k:
                self.tried[names] = item

    def screen(self, wanted: Iterable[Names], near: Names) -> None:
        """Fit sets roughly, from a set that is fitted, and estimate what they miss over left-out rows."""
        starts, owners = [], []
        donor = self.tried[near].fit
        for names in wanted:
            if names in self.screened or names in self.tried:
                continue
            for file in self._files(names, near):
                starts.append(_lend(begun(file), donor))
                owners.append(names)
        fits = fit_twins(starts, self.runs, ROUGHLY) if starts else []
        best: dict[Names, FittedTwin] = {}
        for names, fit in zip(owners, fits, strict=True):
            if names not in best or fit.rmse_k < best[names].rmse_k:
                best[names] = fit
        folds = folds_of(self.runs)
        promised = left_out_errors(list(best.values()), folds, self.runs, 0)
        for (names, fit), errors in zip(best.items(), promised, strict=True):
            self.screened[names] = fit, float(np.sqrt(np.mean(block_squares(errors, folds)[0])))

    def best(self, keys: Iterable[Names]) -> Names:
        """Return the simplest of those that are not clearly worse than the best and fit about as well."""
        items = [self.tried[key] for key in keys if self.pays(key)]
        first = min(items, key=lambda item: item.left_out_k)
        near = []
        for item in items:
            more, error = item.behind(first, self.noise_k)
            fitted = float(np.log(item.fit.rmse_k / first.fit.rmse_k)) if first.fit.rmse_k > 0.0 else 0.0
            if not (more > max(CLEARLY * error, MATTERS) or log_odds(more, error, fitted) > 0.0):
                near.append(item)
        closest = min(item.fit.rmse_k for item in near)
        close = [item for item in near if item.fit.rmse_k <= AS_CLOSE * max(closest, self.noise_k)]
        least = min(self._size(item) for item in close)
        small = [item for item in close if self._size(item) == least]
        top = min(small, key=lambda item: item.left_out_k)
        # What a log hardly tells apart is called by what most boxes have.
        alike = [item for item in small if item.behind(top, self.noise_k)[0] <= MATTERS]
        return max(alike, key=lambda item: (_commonness(item.added), -item.left_out_k)).added

    def _size(self, item: TriedTwin) -> int:
        """Return how many values are free; one that was stated and is open none the less counts twice."""
        stated = sum(value.rel_sd is not None for value in self.file.values().values())
        return len(item.fit.free) + (stated if OPEN in item.added else 0)

    def pays(self, names: Names) -> bool:
        """Return whether each effect is worth something over fitted rows."""
        own = self.tried[names].fit.rmse_k
        less = [self.tried[names - {name}] for name in names if names - {name} in self.tried]
        return all(item.fit.rmse_k >= PAYS * own for item in less)

    @property
    def usual(self) -> list[str]:
        """Candidates that most boxes have."""
        return [name for name in self.candidates if name in EFFECTS and EFFECTS[name].common]

    def is_too_slow(self, names: Names, name: str) -> bool:
        """Return whether an effect of a set hardly changes within the longest run."""
        longest_s = float(self.runs.seen.sum(axis=1).max()) * self.file.sample_s
        return _slowest_s(self.tried[names].fit, name) > SLOWEST_RUNS * longest_s

    def grow(self, seeds: Mapping[Names, FittedTwin] = MappingProxyType({})) -> Names:
        """Add, take away and exchange effects while left-out rows are forecast better.

        seeds : sets to begin with, and fits of other rows whose values they begin from
        """
        plain = {names: begun(_with(self.file, names)) for names in (frozenset[str](), *seeds)}
        lent = [(names, _lend(plain[names], fit)) for names, fit in seeds.items()]
        self.attempt([*lent, *plain.items()])
        for seed in [self.usual, *map(sorted, self.tried)]:
            self._try_one_more(frozenset(), seed)
        now = self.best(self.tried)
        while True:
            self.tell(" + ".join(sorted(now)) or "as given")
            for look in (self._try_one_less, self._try_one_more, self._try_runners_up, self._try_another):
                look(now)
                if (following := self.best(self.tried)) != now:
                    break
            else:
                return now
            now = following

    def close_gap(self, names: Names) -> Names:
        """Add what has no name where left-out rows are forecast much better with it."""
        for _ in range(MOST_UNNAMED):
            if self.tried[names].fit.rmse_k <= EXPLAINED * self.noise_k:
                break
            also = [name for name in nameless_of(self.file, self.runs) if name not in names]
            self._try_one_more(names, also, len(names) + 1)
            own = self.tried[names]
            more = [names | {name} for name in also if names | {name} in self.tried]
            best = min(more, key=lambda key: self.tried[key].left_out_k, default=names)
            gain, error = own.behind(self.tried[best], self.noise_k)
            if not gain > max(CLEARLY * error, MUCH):
                break
            names = best
        return names

    def _files(self, names: Names, near: Names) -> list[TwinFile]:
        """Return the file with each start of what the near one lacks."""
        (new,) = names - near
        donor, kept = self.tried[near].fit, near - {OPEN}
        file = replace(
            self.file, effects={**self.file.effects, **{name: donor.file.effects[name] for name in kept}}
        )
        if OPEN in names:
            file = as_open(file)
        if new == OPEN:
            return [file]
        middle_c = float(np.nanmedian(self.runs.batch.temp))
        return [_turn_at(each, new, middle_c) for each in with_effect(file, new)]

    def attempt_from(self, near: Names, wanted: Iterable[Names]) -> None:
        """Fit sets that were not yet, with the values of one that was."""
        donor = self.tried[near].fit
        self.attempt((names, _lend(begun(_with(self.file, names)), donor)) for names in wanted)

    def _try_one_less(self, names: Names) -> None:
        self.attempt_from(names, [names - {name} for name in sorted(names)])

    def _try_runners_up(self, names: Names) -> None:
        """Add to the sets that come next as well: of two effects the one that pays alone may be neither."""
        others = sorted(
            (item for key, item in self.tried.items() if len(key) <= len(names) and key != names),
            key=lambda item: item.left_out_k,
        )
        for item in others[:RUNNERS_UP]:
            self._try_one_more(item.added)

    def _try_another(self, names: Names) -> None:
        for name in sorted(names):  # a set has no order, and the first look at a set is the only one
            self._try_one_more(names - {name})

    def _try_one_more(
        self, names: Names, candidates: Sequence[str] | None = None, most: int = MOST_ADDED
    ) -> None:
        if len(names) >= most:
            return
        wanted = self.candidates if candidates is None else candidates
        more = [names | {name} for name in wanted if name not in names]
        self.screen(more, names)
        ordered = sorted((key for key in more if key in self.screened), key=lambda key: self.screened[key][1])
        self.attempt((key, self.screened[key][0]) for key in ordered[:LOOKED_AT])


def _slowest_s(fit: FittedTwin, name: str) -> float:
    """Return the longest time constant of an effect, 0 of one that has none [s]."""
    values = {key: value.value for key, value in fit.file.effects[name].items()}
    found = [value for key, value in values.items() if EFFECTS[name].parameter(key).kind in LAGS]
    if (formula := EFFECTS[name].time_constant) is not None:
        found.append(formula[1](values))
    return max(found, default=0.0)


def is_slow(name: str) -> bool:
    """Return whether an effect is a lag or a body that stores heat."""
    effect = EFFECTS.get(name)
    return effect is not None and (
        effect.time_constant is not None or any(item.kind in LAGS for item in effect.parameters)
    )


def _commonness(names: Names) -> int:
    return sum(EFFECTS[name].common > 0 for name in names if name in EFFECTS)


def _with(file: TwinFile, names: Names) -> TwinFile:
    for name in sorted(names - {OPEN}):
        file = with_effect(file, name)[0]
    return as_open(file) if OPEN in names else file


def nameless_of(file: TwinFile, runs: FitRuns) -> list[str]:
    """Return heats of no known cause that may be added without being a name."""
    moves = _moving(file, runs)
    return [
        name
        for name, effect in EFFECTS.items()
        if effect.offer is Offer.NAMELESS
        and name not in file.effects
        and set(effect.must_change) <= moves
        and set(effect.needs) <= set(runs.batch.conditions)
    ]


def _blind(runs: FitRuns, moves: set[str]) -> set[BlindRuns]:
    """Return the kinds of recordings in which an effect never shows, or as what is fitted anyway."""
    batch = runs.batch
    light = batch.conditions.get("light", np.zeros(1))
    return {
        kind
        for kind, is_so in (
            (BlindRuns.HEATER_STEADY, "heater_duty" not in moves),
            (BlindRuns.FAN_OFF, not batch.fan.any()),
            (BlindRuns.FAN_STEADY, bool(batch.fan.any()) and not np.ptp(batch.fan) > 0.0),
            (BlindRuns.ROOM_UNKNOWN, runs.room_is_open),
            (BlindRuns.LIGHT_STEADY, not np.ptp(light) > 0.0),
        )
        if is_so
    }


def _is_open(file: TwinFile, name: str) -> bool:
    """Return whether an effect has a value to be found, so that another can be taken for it."""
    own = file.effects.get(name, {}).values()
    return not name or any(value.fit or value.rel_sd for value in own)


def _moving(file: TwinFile, runs: FitRuns) -> set[str]:
    """Return the commands that change in the runs; those of no fan do not."""
    moves = {"heater_duty"} if np.ptp(runs.batch.duty) > 0.0 else set()
    return moves | {"fan_on"} if file.fan_role != "none" and np.ptp(runs.batch.fan) > 0.0 else moves


def as_open(file: TwinFile) -> TwinFile:
    """Return the file with its uncertain values to be fitted, whatever it says of them."""
    return file.with_values(
        {place: Value(value.value, fit=True) for place, value in file.values().items() if value.rel_sd}
    )


def _turn_at(file: TwinFile, name: str, middle_c: float) -> TwinFile:
    """Return the file with an effect that turns about some temperature, about that of the runs' middle."""
    places = [("effects", name, item.name) for item in EFFECTS[name].parameters]
    turning = [p for p in places if EFFECTS[name].parameter(p[2]).kind is ParameterKind.TURNING_POINT]
    return file.with_values({place: Value(middle_c, fit=True) for place in turning})


def _lend(start: Begun, donor: FittedTwin) -> Begun:
    known = {item.place: float(x) for item, x in zip(donor.free, donor.x, strict=True)}
    x = np.array([known.get(item.place, float(own)) for item, own in zip(start.free, start.x, strict=True)])
    return Begun(start.file, start.free, x)


def candidates_of(file: TwinFile, runs: FitRuns) -> list[str]:
    """Return effects that are not there, have their columns, and whose input moved.

    Some are never names, as every warm box has them: without them others would be taken for what they do.
    """
    have, known, moves = set(runs.batch.conditions), file.effects, _moving(file, runs)
    blind = _blind(runs, moves)
    useless = {*known, *(EFFECTS[name].replaces for name in known)}
    opened = [OPEN] if any(value.rel_sd for value in file.values().values()) else []
    return opened + [
        name
        for name, effect in EFFECTS.items()
        if (effect.offer is Offer.CANDIDATE or (effect.offer is Offer.KNOWN_ONLY and effect.stands_in))
        and set(effect.must_change) <= moves
        and not any(item.runs in blind and _is_open(file, item.looks_like) for item in effect.hidden_by)
        and name not in useless
        and {*effect.needs, *effect.offered_with} <= have
        and (file.fan_role == "exhaust" or not effect.by_flow)
    ]


def folds_of(runs: FitRuns) -> list[tuple[Mask, Mask]]:
    """Return rows to fit and rows to judge by: whole runs left out, or each part forecast from its past."""
    count, rows = runs.seen.shape
    if count >= WHOLE_RUNS:
        found = []
        for part in np.array_split(np.arange(count), min(FOLDS, count)):
            judged = np.zeros((count, rows), dtype=bool)
            for i in part:
                judged[i, 0 if runs.rests[i] else FIRST_ROWS :] = True
            found.append((~judged, judged))
        return found
    ends = np.array([np.flatnonzero(row)[-1] + 1 for row in runs.seen])[:, None]
    at = np.arange(rows)[None]
    return [
        (at < np.round(begin * ends), (at >= np.round(begin * ends)) & (at < np.round(end * ends)))
        for begin, end in pairwise(SPLITS)
    ]


def block_squares(errors: Floats, folds: Sequence[tuple[Mask, Mask]]) -> tuple[Floats, Indices]:
    """Return the mean square of each block of left-out rows [K²], and of which fold it is."""
    found, parts = [], []
    stretches = [
        (k, errors[i][judged[i]])
        for k, (_, judged) in enumerate(folds)
        for i in range(len(errors))
        if judged[i].any()
    ]
    each = max(1, BLOCKS // len(stretches))
    for k, stretch in stretches:
        for block in np.array_split(stretch, each):
            known = block[np.isfinite(block)]
            if len(known):
                found.append(float(np.mean(known**2)))
                parts.append(k)
    return np.array(found), np.array(parts)
