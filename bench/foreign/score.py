"""python -m bench.foreign run, score: a solver on every case, and its answers against truths.

A name is right strictly where it is hidden in the box, and by class where a log of temperatures hardly tells
it from what is (ALIASES of bench/foreign/cases.py). Errors are those of free runs over test rows [K]; the
baselines (one mass, heater lag, two masses, ARX 2 to 4) are fitted to the same training rows. Cases of the
greenhouse have rows of their own, and no part in the others.
"""

import argparse
import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

from bench.foreign.cases import ALIASES, PLACES
from bench.foreign.greenhouse import KINDS as GREENHOUSE
from bench.foreign.make import Task, add_place, name_of, tasks_of
from bench.foreign.run_cases import LIMIT_S, OURS, PYSINDY, SolverTask, is_done, run_all
from bench.header import Share, share
from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.report.wording import beaten
from edge.formats.table import Table

SURE = 0.95
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.01)
TRUSTED = {"UA": "effects.wall_loss.UA", "kC": "effects.extra_capacity.kC"}
NEAR_BEST, NEAR_SIMPLE = 1.02, 1.10


def run_cases(words: Sequence[str]) -> int:
    """Run the solver on what has no answer of its present files yet."""
    parser = argparse.ArgumentParser(prog="python -m bench.foreign run", description=__doc__)
    add_place(parser)
    _add_solver(parser)
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="of one case; default: %(default)g")
    parser.add_argument("--again", action="store_true", help="also what has an answer")
    arguments = parser.parse_args(words)
    wanted = []
    for task in tasks_of(arguments):
        folder = task[0] / "cases" / name_of(task)
        answer = answer_of(task[0], name_of(task), arguments.solver)
        wanted.append(SolverTask(arguments.solver, folder, answer, arguments.limit_s))
    missing = [task for task in wanted if arguments.again or not is_done(task)]
    run_all(missing, arguments.workers, arguments.dask)
    return 0


def _add_solver(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--solver", choices=(OURS, PYSINDY), default=OURS, help="default: %(default)s")


def answer_of(root: Path, name: str, solver: str = OURS) -> Path:
    """Folder of a case's answer."""
    return root / ("answers" if solver == OURS else solver) / name


@dataclass(frozen=True, slots=True)
class ScoredAnswer:
    """One answer. statements : probability and whether it is true, of every name that was given one

    ratio_given, ratio_simple : test error over that of the fitted twin as given, and of the best baseline
    closed : share of the test gap that is gone, down to the sensor's noise
    """

    name: str
    kind: str
    hidden: tuple[str, ...]
    outside: str
    verdict: str
    named: tuple[str, ...] = ()
    strict: tuple[bool, ...] = ()
    by_class: tuple[bool, ...] = ()
    statements: tuple[tuple[float, bool], ...] = ()
    depends_right: bool = False
    places: tuple[frozenset[str], frozenset[str]] = (frozenset(), frozenset())
    bias: tuple[float, ...] = ()
    covered: tuple[bool, ...] = ()
    ratio_given: float = math.nan
    ratio_simple: float = math.nan
    closed: float = math.nan
    is_offered: bool = False
    admits: bool = False
    wall_s: float = math.nan
    cpu_s: float = math.nan
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_exact(self) -> bool:
        """All that is hidden is named, by class, and nothing else."""
        return len(self.named) == len(self.hidden) and all(self.by_class)


def is_alike(name: str, other: str) -> bool:
    """Return whether a log hardly tells the two apart."""
    return name == other or any({name, other} <= own for own in ALIASES)


def score(
    name: str, truth: Mapping[str, Any], found: Mapping[str, Any] | None, run: Mapping[str, Any]
) -> ScoredAnswer:
    """found : diagnosis.json, None where there is none"""
    hidden, outside = tuple(truth["hidden"]), truth["outside"]
    seconds = {"wall_s": run["wall_s"], "cpu_s": run["cpu_s"]}
    if found is None:
        return ScoredAnswer(name, truth["kind"], hidden, outside, "failed", **seconds)
    names = tuple(item["name"] for item in found["effects"])
    tests = found["left_out"]["test_k"] | _gaps(found)
    after = tests.get("after", math.nan)
    simple = min((tests[key] for key in tests if key not in ("before", "after")), default=math.nan)
    # What the sensor adds can't be explained by any twin: only the gap above it counts.
    floor = math.hypot(truth["noise_k"], truth["step_k"] / math.sqrt(12.0))
    gap = tests.get("before", math.nan) - floor
    return ScoredAnswer(
        name,
        truth["kind"],
        hidden,
        outside,
        found["verdict"],
        names,
        tuple(own in hidden for own in names),
        tuple(match_names(names, hidden)),
        tuple(
            (item["probability"], any(is_alike(item["name"], own) for own in hidden))
            for item in [*found["effects"], *found["doubtful"]]
            if item.get("probability") is not None
        ),
        bool(set(found["depends_on"][:2]) & set(truth["depends_on"])),
        (_places(names), _places(hidden)),
        tuple(_bias(found, truth)),
        tuple(_coverage(found, truth)),
        after / tests.get("before", math.nan),
        after / simple,
        (tests.get("before", math.nan) - after) / gap if gap > 0.0 else math.nan,
        found["twin_after"] is not None,
        bool(beaten(cast(DiagnosisDocument, found))),
        **seconds,
        extra={"test_k": tests, "against": found["against_adopting"], "doubtful": found["doubtful"]},
    )


def _gaps(found: Mapping[str, Any]) -> dict[str, float]:
    gaps = {key: found["gap"][key]["test"] for key in ("before", "after")}
    return {key: own["rmse_k"] for key, own in gaps.items() if own}


def match_names(names: Sequence[str], hidden: Sequence[str]) -> Iterable[bool]:
    """Each hidden effect finds one name at most, a strict one first."""
    left = [own for own in hidden if own not in names]
    for name in names:
        if name in hidden:
            yield True
            continue
        match = next((own for own in left if is_alike(name, own)), None)
        if match is not None:
            left.remove(match)
        yield match is not None


def _places(names: Iterable[str]) -> frozenset[str]:
    return frozenset(place for place, own in PLACES.items() for name in names if name in own)


def _bias(found: Mapping[str, Any], truth: Mapping[str, Any]) -> Iterable[float]:
    """Relative error of what the twin file gives to be fitted."""
    values = found.get("values", {})
    for key, true in truth.get("known", {}).items():
        if TRUSTED[key] in values:
            yield abs(values[TRUSTED[key]]["value"] - true) / abs(true)


def _coverage(found: Mapping[str, Any], truth: Mapping[str, Any]) -> Iterable[bool]:
    for item in found["effects"]:
        for key, true in truth["hidden"].get(item["name"], {}).items():
            own = item["parameters"].get(key)  # a peer reports no values
            if own:
                yield own["low"] is not None and own["low"] <= true <= own["high"]


def figures(cases: Sequence[ScoredAnswer]) -> dict[str, Share | float]:
    """Every figure of the table."""
    greenhouse = _figures_of_greenhouse(*(_of(cases, kind) for kind in GREENHOUSE))
    cases = [case for case in cases if case.kind not in GREENHOUSE]
    single, pair, outside = (_of(cases, kind) for kind in ("single", "pair", "outside"))
    library = [*single, *pair]
    statements = [own for case in cases for own in case.statements]
    offered = [case for case in cases if case.is_offered]
    closed = [case.closed for case in outside if math.isfinite(case.closed)]
    bias = [own for case in cases for own in case.bias if case.kind == "null" or all(case.by_class)]
    # Over all cases at once: a case with nothing to find has no F1 of its own.
    hits = sum(len(found & true) for found, true in (case.places for case in library))
    told = sum(len(found) + len(true) for found, true in (case.places for case in library))
    return {
        "first name, strict": share(bool(case.strict[:1] and case.strict[0]) for case in library),
        "first name, by class": share(bool(case.by_class[:1] and case.by_class[0]) for case in library),
        "exact single, by class": share(case.is_exact for case in single),
        "exact pair, by class": share(case.is_exact for case in pair),
        "null: something named": share(bool(case.named) for case in _of(cases, "null")),
        "null: nothing missing said": share(case.verdict == "nothing_missing" for case in _of(cases, "null")),
        "lid: something named": share(bool(case.named) for case in _of(cases, "lid")),
        "outside: unknown said": share(case.verdict == "unknown" for case in outside),
        "outside: something named": share(bool(case.named) for case in outside),
        "outside: depends on the right thing": share(case.depends_right for case in outside),
        "unknown said wrongly": share(case.verdict == "unknown" for case in cases if case.kind != "outside"),
        "false names (false discovery rate)": share(not own for case in cases for own in case.by_class),
        f"false with probability >= {SURE}": share(not true for own, true in statements if own >= SURE),
        "calibration error": calibration_error(statements),
        "localisation F1": 2.0 * hits / told if told else math.nan,
        "trusted parameters' bias, median": statistics.median(bias) if bias else math.nan,
        "trusted parameters' bias, p90": _quantile(bias, 0.9),
        "intervals that cover": share(own for case in cases for own in case.covered),
        "test error at most 1.02 of the fitted twin as given": share(
            case.ratio_given <= NEAR_BEST for case in cases if math.isfinite(case.ratio_given)
        ),
        "test error at most 1.10 of the best baseline": share(
            case.ratio_simple <= NEAR_SIMPLE for case in cases if math.isfinite(case.ratio_simple)
        ),
        "outside: half of the gap closed": share(own >= 0.5 for own in closed),
        "offered for adoption": share(case.is_offered for case in cases),
        "offered, worse than the best baseline, not said": share(
            case.ratio_simple > 1.0 and not case.admits for case in offered
        ),
        "seconds of processor, median": _quantile([case.cpu_s for case in cases], 0.5),
        "seconds of processor, most": _quantile([case.cpu_s for case in cases], 1.0),
        "no answer": share(case.verdict == "failed" for case in cases),
        **greenhouse,
    }


def _figures_of_greenhouse(hidden: Sequence[ScoredAnswer], null: Sequence[ScoredAnswer]) -> dict[str, Share]:
    return {
        "greenhouse: first name, strict": share(case.strict[:1] == (True,) for case in hidden),
        "greenhouse: first name, by class": share(case.by_class[:1] == (True,) for case in hidden),
        "greenhouse: exact, by class": share(case.is_exact for case in hidden),
        "greenhouse: false names": share(not own for case in (*hidden, *null) for own in case.by_class),
        "greenhouse: unknown said": share(case.verdict == "unknown" for case in (*hidden, *null)),
        "greenhouse null: something named": share(bool(case.named) for case in null),
        "greenhouse null: nothing missing said": share(case.verdict == "nothing_missing" for case in null),
        "greenhouse: no answer": share(case.verdict == "failed" for case in (*hidden, *null)),
    }


def calibration_error(statements: Sequence[tuple[float, bool]]) -> float:
    """Mean distance between what was said and what held, over BINS, weighted by their statements."""
    total = 0.0
    for own in bins(statements).values():
        said, held = (sum(values) / len(own) for values in zip(*own, strict=True))
        total += len(own) * abs(said - held)
    return total / len(statements) if statements else math.nan


def bins(statements: Sequence[tuple[float, bool]]) -> dict[tuple[float, float], list[tuple[float, bool]]]:
    """Statements by the bin of their probability."""
    found = {}
    for low, high in pairwise(BINS):
        own = [item for item in statements if low <= item[0] < high]
        if own:
            found[low, high] = own
    return found


def _of(cases: Sequence[ScoredAnswer], kind: str) -> list[ScoredAnswer]:
    return [case for case in cases if case.kind == kind]


def _quantile(values: Sequence[float], level: float) -> float:
    return sorted(values)[max(0, math.ceil(level * len(values)) - 1)] if values else math.nan


def read_scored(task: Task, solver: str = OURS) -> ScoredAnswer | None:
    """None where the case has not been run."""
    root, name = task[0], name_of(task)
    folder = answer_of(root, name, solver)
    if not (folder / "run.json").exists():
        return None
    truth = json.loads((root / "truth" / f"{name}.json").read_text(encoding="utf-8"))
    path = folder / "diagnosis.json"
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    return score(name, truth, found, json.loads((folder / "run.json").read_text(encoding="utf-8")))


def text(cases: Sequence[ScoredAnswer]) -> str:
    """Return the table, the reliability of the probabilities, and a line for each case that went wrong."""
    found = tuple((name, _figure(value)) for name, value in figures(cases).items())
    statements = [own for case in cases for own in case.statements]
    held = tuple(
        (f"{low:.2f} to {min(high, 1.0):.2f}", _figure(share(true for _, true in own)))
        for (low, high), own in bins(statements).items()
    )
    tables = (
        Table("", (f"{len(cases)} cases", ""), found, words=True),
        Table("", ("said", "held"), held, words=True),
    )
    return "\n".join(line for one in tables for line in one.text())


def _figure(value: Share | float) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if not value.cases:
        return "-"
    low, high = value.interval
    return f"{value.value:.2f} [{low:.2f}, {high:.2f}] of {value.cases}"


def main(words: Sequence[str] | None = None) -> int:
    """Score what was run, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.foreign score", description=__doc__)
    add_place(parser)
    _add_solver(parser)
    parser.add_argument("--each", action="store_true", help="a line a case too")
    parser.add_argument("--write", type=Path, help="the table, to this file too")
    arguments = parser.parse_args(words)
    answers = [read_scored(task, arguments.solver) for task in tasks_of(arguments)]
    cases = [own for own in answers if own is not None]
    if arguments.each:
        for case in cases:
            print(_line(case))
    print(text(cases), end="")
    if arguments.write:
        arguments.write.write_text(text(cases), encoding="utf-8")
    return 0


def _line(case: ScoredAnswer) -> str:
    told = "+".join(
        name if strict else f"({name})" if own else f"!{name}"
        for name, strict, own in zip(case.named, case.strict, case.by_class, strict=True)
    )
    hidden = "+".join(case.hidden) or case.outside or case.kind
    return (
        f"{case.name} {hidden:36} {case.verdict[:7]:8} {told:40} given {case.ratio_given:.2f} "
        f"simple {case.ratio_simple:.2f} closed {case.closed:.2f} {'offered' if case.is_offered else ''} "
        f"{case.cpu_s:.0f} s"
    )
