"""The comparison's figures as files: one run a line, what differs from what is kept, what stays of it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from edge.core.errors import DataError
from training.control.comparison import Results, RunResult
from training.control.figures import DecisionTime, Figures
from training.evaluate.difference import first_difference

FIGURES_FILE, TIMES_FILE = "comparison.json", "times.json"

Times = Mapping[str, Sequence[DecisionTime]]  # controller -> one for each run


def json_of(results: Results) -> str:
    """All digits, a run on each line."""
    return "[\n" + ",\n".join(json.dumps(asdict(one)) for one in results) + "\n]\n"


def results_of(text: str) -> list[RunResult]:
    """Read what `json_of` wrote."""
    return [RunResult(**{**row, "figures": Figures(**row["figures"])}) for row in json.loads(text)]


def read_results(folder: Path) -> list[RunResult]:
    """Those that are kept. Errors: DataError"""
    path = folder / FIGURES_FILE
    try:
        return results_of(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error


def times_json(times: Times) -> str:
    """By controller."""
    rows = {name: [asdict(one) for one in found] for name, found in times.items()}
    return json.dumps(rows, indent=1) + "\n"


def read_times(folder: Path) -> Times:
    """Read what `times_json` wrote. Errors: DataError"""
    path = folder / TIMES_FILE
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return {name: [DecisionTime(**one) for one in found] for name, found in rows.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error


def beside(kept: Results, now: Results, names: Sequence[str]) -> list[RunResult]:
    """`now`, with what is kept of all other runs; in the order in which they would be done."""
    runs = {_run(one): one for one in (*kept, *now)}
    order = {name: i for i, name in enumerate(names)}
    known = (one for one in runs.values() if one.entry in order)  # not one that has been given up
    return sorted(known, key=lambda one: (one.reference, one.seed, order[one.entry]))


def times_beside(kept: Times, now: Times, names: Sequence[str]) -> Times:
    """Return decision times in the same form. A controller counts only with all of its runs."""
    whole = {name: found for name, found in now.items() if len(found) >= len(kept.get(name, ()))}
    return {name: both[name] for name in names if name in (both := {**kept, **whole})}


def first_change(kept: Results, now: Results, tolerance: float = 0.0) -> str:
    """Return the first figure of `now` that differs from the saved one, "" where none does.

    tolerance : share of the saved figure that it may differ by
    """
    runs = {_run(one): one for one in kept}
    for one in now:
        place = f"{one.entry}, {one.reference}, seed {one.seed}"
        if (before := runs.get(_run(one))) is None:
            return f"{place}: no such run is kept"
        if found := first_difference(asdict(before), asdict(_round(before, one, tolerance)), place=place):
            return found
    return ""


def _round(saved: RunResult, now: RunResult, tolerance: float) -> RunResult:
    """Return `now` with the saved value of each figure that is within the tolerance."""
    pairs = {name: (value, getattr(now.figures, name)) for name, value in asdict(saved.figures).items()}
    near = {name: a for name, (a, b) in pairs.items() if abs(a - b) <= tolerance * abs(a)}
    return replace(now, figures=replace(now.figures, **near))


def _run(one: RunResult) -> tuple[str, str, int]:
    return one.entry, one.reference, one.seed
