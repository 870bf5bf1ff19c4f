"""One answer held against one truth, and both as the scorer reads them.

Read: which cases are meant and their truths; of a diagnosis only what the contract says, and nothing of it
believed.

Names: an effect is found where the name given for it is in its alias class (`score_aliases`) and it is not
hedged over more than MOST_ALTERNATIVES alternatives; each name finds one effect at most, an exact name first.

Alias class told: of a found effect the answer tells {name} and its alternatives. That is honest where it
tells every member of the scorer's class that is clearly in (within CLEARLY_IN_NATS of the truth; a fit is
good to about one) and nothing that is clearly out (beyond CLEARLY_OUT_NATS). Between the two either is right.
An effect that is not found was not told honestly.

Intervals: of effects that are named exactly (not by an alias), each parameter that is given and whose truth
is known; one without ends does not cover.

Gap: root mean square over the test rows whose temperature was not given, where it was measured; a prediction
that is missing, of another length or not finite is infinitely wrong. Shrink = (before - after) / (before -
floor), not counted where before is not SHRINKABLE times the floor; the floor is what the true equations and
parameters miss from the true start, without the heat noise and mains that nobody could know.
"""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.cases import (
    FIRST_SEEDS,
    GENERATOR_VERSION,
    GIVEN_ROWS,
    KINDS,
    SUITES,
    HiddenEffect,
    RunTruth,
    Truth,
)
from bench.hidden_effects.score_aliases import AliasClass
from edge.core.errors import DataError

Floats = NDArray[np.float64]
VERDICTS = ("named", "nothing_missing", "unknown")
MOST_ALTERNATIVES = 5  # more is no answer
CLEARLY_IN_NATS, CLEARLY_OUT_NATS = 2.0, 6.0
SHRINKABLE = 1.05
COUNTED_DEPENDENCES = 2


def read_truth(path: Path) -> Truth:
    """Read the truth of a case. Errors: DataError naming the file, if it is invalid or of another version"""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        truth = _truth(document)
    except (OSError, json.JSONDecodeError, TypeError, KeyError) as error:
        raise DataError(f"{path}: no truth of a case: {error!r}") from error
    if truth.generator_version != GENERATOR_VERSION:
        raise DataError(f"{path}: of generator version {truth.generator_version}: make the cases anew")
    return truth


def _truth(document: dict[str, Any]) -> Truth:
    outside = document["outside"]
    return Truth(
        **{
            **document,
            "hidden": tuple(HiddenEffect(**item) for item in document["hidden"]),
            "outside": None if outside is None else HiddenEffect(**outside),
            "depends_on": tuple(document["depends_on"]),
            "known": tuple(document["known"]),
            "tests": {name: RunTruth(**item) for name, item in document["tests"].items()},
        }
    )


class CasePaths(NamedTuple):
    """A case's folder, and the file of its truth."""

    folder: Path
    truth: Path


def add_place(parser: argparse.ArgumentParser) -> None:
    """Arguments of `run`, `score` and `table`: where cases and answers lie, and which."""
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--split", choices=list(FIRST_SEEDS), default="dev")
    parser.add_argument("--root", type=Path, default=Path("out/hidden"), help="of the cases")
    parser.add_argument("--results", type=Path, default=Path("out/hidden_results"))
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma between; default: %(default)s")
    parser.add_argument("--per-kind", type=int, help="first cases of each kind; default: all that are there")


def cases_of(arguments: argparse.Namespace) -> list[CasePaths]:
    """Return the cases that the arguments mean, in order. Errors: DataError where there are none"""
    place = arguments.root / arguments.suite / arguments.split
    kinds, found = dict.fromkeys(arguments.kinds.split(","), 0), []
    for path in sorted((place / "truth").glob("case_*.json")):
        kind = read_truth(path).kind
        if kind not in kinds or kinds[kind] == arguments.per_kind:
            continue
        kinds[kind] += 1
        found.append(CasePaths(place / "cases" / path.stem, path))
    if not found:
        raise DataError(f"{place}: no case of {arguments.kinds}: make them first")
    return found


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect of an answer. intervals : low and high by parameter, NaN where there is none."""

    name: str
    alternatives: tuple[str, ...]
    intervals: Mapping[str, tuple[float, float]]

    @property
    def hedges(self) -> bool:
        """True for an answer with more alternatives than the contract allows."""
        return len(set(self.alternatives) - {self.name}) > MOST_ALTERNATIVES


@dataclass(frozen=True, slots=True)
class DiagnosisAnswer:
    """A diagnosis. before, after : predictions of test runs by file name, NaN where there is none [°C]."""

    verdict: str
    effects: tuple[NamedEffect, ...]
    depends_on: tuple[str, ...]
    before: Mapping[str, Floats]
    after: Mapping[str, Floats]


def read_answer(path: Path) -> DiagnosisAnswer:
    """Read the diagnosis in a file. Errors: DataError naming the file, if it is missing or invalid"""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return answer(document)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: no diagnosis: {error!r}") from error


def answer(document: Mapping[str, Any]) -> DiagnosisAnswer:
    """Return the answer of a document. Errors: ValueError, KeyError,
    TypeError, AttributeError for an invalid one
    """
    verdict = document["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"verdict {verdict!r} is none of {VERDICTS}")
    effects = document["effects"] if verdict == "named" else []  # others have no say
    if verdict == "named" and not effects:
        raise ValueError("the verdict is 'named', but no effect is")
    predictions = document["predictions"]
    return DiagnosisAnswer(
        verdict,
        tuple(_named_effect(item) for item in effects),
        tuple(document["depends_on"]),
        {run: _series(own["before"]) for run, own in predictions.items()},
        {run: _series(own["after"]) for run, own in predictions.items()},
    )


def _named_effect(document: Mapping[str, Any]) -> NamedEffect:
    intervals = {
        key: (_number(item.get("low")), _number(item.get("high")))
        for key, item in document["parameters"].items()
    }
    return NamedEffect(document["name"], tuple(document["alternatives"]), intervals)


def _series(values: list[float | None]) -> Floats:
    return np.array([_number(item) for item in values], dtype=np.float64)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


@dataclass(frozen=True, slots=True)
class FreeRunErrors:
    """Errors of free runs over the test runs together, RMSE [K]."""

    before_k: float
    after_k: float
    floor_k: float

    @property
    def shrink(self) -> float | None:
        """1 where the gap is gone; None where there was none worth the name."""
        if not self.before_k > SHRINKABLE * self.floor_k:
            return None
        if not math.isfinite(self.after_k) or not math.isfinite(self.before_k):
            return -math.inf
        return (self.before_k - self.after_k) / (self.before_k - self.floor_k)

    @property
    def ratio(self) -> float:
        """Error after the diagnosis over the noise floor, 1 at best."""
        return self.after_k / self.floor_k


@dataclass(frozen=True, slots=True)
class ScoredCase:
    """The score of an answer.

    failed : no answer at all; then everything else is wrong
    found : per hidden effect, whether it was found; true_names, names : how many names are true, of how many
    first_right : the first name is true; exact : all hidden effects found and nothing else named
    told : per hidden effect, whether its class was told honestly; told_exactly : as the class has it
    has_rivals, shows : per hidden effect, whether its class has others, whether the runs show it at all
    covered : per parameter of exactly named effects
    dependence : a true one among the first two; None where there is none to name
    """

    case: str
    kind: str
    hidden: tuple[str, ...]
    outside: str
    verdict: str
    failed: bool
    named: tuple[str, ...] = ()
    found: tuple[bool, ...] = ()
    names: int = 0
    true_names: int = 0
    first_right: bool = False
    exact: bool = False
    told: tuple[bool, ...] = ()
    told_exactly: tuple[bool, ...] = ()
    has_rivals: tuple[bool, ...] = ()
    shows: tuple[bool, ...] = ()
    covered: Mapping[str, bool] = field(default_factory=dict)
    dependence: bool | None = None
    errors: FreeRunErrors | None = None
    seconds: float = math.nan
    cpu_s: float = math.nan


def score(
    truth: Truth,
    classes: Sequence[AliasClass],
    given: DiagnosisAnswer | None,
    seconds: float = math.nan,
    cpu_s: float = math.nan,
) -> ScoredCase:
    """Score an answer, None if there is none. seconds, cpu_s : by the clock, and of processors"""
    hidden = tuple(item.name for item in truth.hidden)
    outside = truth.outside.name if truth.outside else ""
    verdict = given.verdict if given else "failed"
    matched = _match(classes, given.effects if given else ())
    names = given.effects if given else ()
    true = [item for item in matched if item is not None]
    # The first name counts apart: most readers go no further.
    first = names[0] if names else None
    return ScoredCase(
        truth.id,
        truth.kind,
        hidden,
        outside,
        verdict,
        failed=given is None,
        named=tuple(item.name for item in names),
        found=tuple(item is not None for item in matched),
        names=len(names),
        true_names=len(true),
        first_right=any(item is first for item in true),
        exact=bool(hidden) and len(true) == len(hidden) == len(names),
        told=tuple(_is_honest(own, item) for own, item in zip(classes, matched, strict=True)),
        told_exactly=tuple(item is not None and _told_names(item) == own.members
                           for own, item in zip(classes, matched, strict=True)),
        has_rivals=tuple(len(own.members) > 1 for own in classes),
        shows=tuple(own.shows for own in classes),
        covered=_coverage(truth, names),
        dependence=_dependence(truth, given),
        errors=errors(truth.tests, given),
        seconds=seconds,
        cpu_s=cpu_s,
    )  # fmt: skip


def _match(classes: Sequence[AliasClass], names: Sequence[NamedEffect]) -> list[NamedEffect | None]:
    """Match a name to each hidden effect: exact ones first, then as many by class as possible."""
    left = [item for item in names if not item.hedges]
    found: list[NamedEffect | None] = []
    for own in classes:
        exact = next((item for item in left if item.name == own.effect), None)
        found.append(exact)
        if exact is not None:
            left.remove(exact)
    for i in sorted(range(len(classes)), key=lambda i: len(classes[i].members)):  # the choosiest first
        if found[i] is None:
            found[i] = next((item for item in left if item.name in classes[i].members), None)
            left = [item for item in left if item is not found[i]]
    return found


def _told_names(named: NamedEffect) -> frozenset[str]:
    return frozenset({named.name, *named.alternatives})


def _is_honest(own: AliasClass, named: NamedEffect | None) -> bool:
    if named is None:
        return False
    return own.within(CLEARLY_IN_NATS) <= _told_names(named) <= own.up_to(CLEARLY_OUT_NATS)


def _coverage(truth: Truth, names: Sequence[NamedEffect]) -> dict[str, bool]:
    covered = {}
    named = {item.name: item for item in reversed(names)}  # the first of two of one name
    for hidden in truth.hidden:
        if hidden.name not in named:
            continue
        for key, value in hidden.parameters.items():
            if key in named[hidden.name].intervals:
                low, high = named[hidden.name].intervals[key]
                covered[f"{hidden.name}.{key}"] = low <= value <= high  # NaN: no
    return covered


def _dependence(truth: Truth, given: DiagnosisAnswer | None) -> bool | None:
    if not truth.depends_on:
        return None
    if given is None or given.verdict != "unknown":
        return False
    return bool(set(given.depends_on[:COUNTED_DEPENDENCES]) & set(truth.depends_on))


def errors(tests: Mapping[str, RunTruth], given: DiagnosisAnswer | None) -> FreeRunErrors | None:
    """Before, after and at the floor; None where there is nothing to predict."""
    measured = [np.array([math.nan if x is None else x for x in own.measured_c]) for own in tests.values()]
    floor = [np.asarray(own.undisturbed_c) for own in tests.values()]
    counted = [np.isfinite(values) & (np.arange(len(values)) >= GIVEN_ROWS) for values in measured]
    if not sum(int(rows.sum()) for rows in counted):
        return None

    def rmse(predicted: Sequence[Floats | None]) -> float:
        squares = []
        for series, values, rows in zip(predicted, measured, counted, strict=True):
            if series is None or len(series) != len(values):
                return math.inf
            squares.append((series - values)[rows] ** 2)
        found = math.sqrt(float(np.concatenate(squares).mean()))
        return found if math.isfinite(found) else math.inf

    before = {} if given is None else given.before
    after = {} if given is None else given.after
    return FreeRunErrors(
        rmse([before.get(name) for name in tests]), rmse([after.get(name) for name in tests]), rmse(floor)
    )
