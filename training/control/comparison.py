"""The comparison's figures from saved runs, by controller, reference and seed; their tables, and the saved
figures.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

from edge.core.controller_names import LLM
from edge.core.errors import DataError
from edge.formats.table import Table
from training.control.closed_loop import ClosedLoopLog
from training.control.figures import DecisionTime, Figures, Mean, figures, mean_of, ratio
from training.control.job import ComparisonJob
from training.control.rig import entries
from training.evaluate.difference import first_difference
from training.llm_stand_in import MODEL as STAND_IN

STAND_IN_MODEL = "stand-in"  # its name as `llm.model`
BY = " by "  # between an entry and the model that decided
EVERYTHING, COMING, BAND, PRESENT = range(4)
KNOWLEDGE = (
    "everything", "coming reference", "coming, kept to until 0.3 K of a step", "present reference",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run in figures.

    model : of a language model's row, with size and quantisation; "" of all others
    remark : written by a person about a run that is older than its row
    """

    entry: str
    reference: str
    seed: int
    figures: Figures
    model: str = ""
    remark: str = ""

    @property
    def row(self) -> str:
        """Its row's name in tables: each language model has rows of its own."""
        return f"{self.entry}{BY}{self.model}" if self.model else self.entry


Results = Sequence[RunResult]


def result(job: ComparisonJob, log: ClosedLoopLog) -> RunResult:
    """Return the result of one saved run."""
    model = job.llm.model if job.entry.controller in LLM else ""
    model = STAND_IN if model == STAND_IN_MODEL else model
    return RunResult(job.entry.name, job.reference, job.seed, figures(log), model)


def without_stand_in(results: Results) -> list[RunResult]:
    """Return the runs that are ranked: without those in which a script stood in for a language model."""
    return [one for one in results if one.model != STAND_IN]


def of_stand_in(results: Results) -> list[RunResult]:
    """Return the runs in which a script stood in for a language model."""
    return [one for one in results if one.model == STAND_IN]


def rows_of(results: Results, names: Sequence[str]) -> list[str]:
    """Return the rows that have run, in the order of the entries `names`."""
    found = {(one.entry, one.row) for one in results}
    return [row for name in names for entry, row in sorted(found) if entry == name]


def column(results: Results, row: str, reference: str, name: str) -> list[float]:
    """Return a figure by seed, in the seeds' order; empty where there is no run."""
    mine = sorted((one for one in results if (one.row, one.reference) == (row, reference)), key=_seed)
    return [float(value) for one in mine if (value := getattr(one.figures, name)) is not None]


def regret(
    results: Results, row: str, reference: str, by_sensor: bool, among_equals: bool = False
) -> Mean | None:
    """Return the cost by the limit's of the same weight, None without a run of either.

    The limit of a seed is the cheapest of all its runs by that cost: the clairvoyant's own plan, that of its
    sibling for the other weight, or a controller's. A beam search prunes and may miss the best plan.
    among_equals : only the runs that do no more with the coming reference than `row`
    """
    ending = "-P" if "-P" in _entry(row) else ""
    cost = ("sensor_cost_" if by_sensor else "cost_") + ("1" if ending else "0")
    limits = clairvoyants(by_sensor, bool(ending))
    both = seeds_of(results, row, reference) & set().union(
        *(seeds_of(results, limit, reference) for limit in limits)
    )
    rows = [one for one in results if one.reference == reference and one.seed in both]
    least = _knowledge(row) if among_equals else EVERYTHING
    equals = [one for one in rows if least <= COMING or _knowledge(one.row) >= least]
    best = [min(getattr(one.figures, cost) for one in equals if one.seed == seed) for seed in sorted(both)]
    return ratio(column(rows, row, reference, cost), best) if both else None


def clairvoyants(by_sensor: bool, penalised: bool) -> list[str]:
    """Return the names of those that plan for one air and weight of effort."""
    air = "sensor" if by_sensor else "true"
    return [name for name, one in entries().items() if one.clairvoyant == air and ("-P" in name) == penalised]


WHOLE = {  # with penalty -> the best plan with a fan of whole steps
    "MPC-Twin-P": "clairvoyant/sensor-P/band/whole",
    "MPC-Twin-P/early": "clairvoyant/sensor-P/whole",
}
COLUMNS = {  # heading -> figure, digits
    "MAE": ("mae_measured", 3), "true": ("mae_true", 3), "RMSE": ("rmse_true", 3), "near %": ("near_pct", 1),
    "overshoot": ("overshoot_k", 2), "Wh": ("energy_wh", 0), "fan min": ("fan_min", 0),
    "switches": ("switches", 0), "cycles": ("cycles", 1), "before": ("before_k", 2), "travel": ("travel", 1),
    "safety": ("interventions", 1), "fallback": ("fallbacks", 1), "tokens": ("tokens", 0),
}  # fmt: skip
NOTE = (
    "Means of the seeds, +- half of their 95 % interval. MAE: by the sensor; true, RMSE, near (share "
    "within 0.5 K) and overshoot after steps: by the mean of the air in the box [K]; cycles: starts of the"
    " fan within ten minutes of the last, with heat between; before: how far the air at the sensor left "
    "the reference towards a step before it, at the ends of steps, the most of the run [K]; travel: sum of"
    " |change of duty|; safety: commands changed; fallback: ticks decided by another controller. x best: "
    "cost, of weight 1 for -P and 0 else, by that of the cheapest plan known, seed by seed; x sensor: the "
    "same where both are judged by the air at the sensor, its 0.4 K of bias with it, which is all that a "
    "controller can know; x equal: the same by the cheapest plan that does no more with the coming "
    "reference. Ranked by x sensor among those that do as much with it: everything to come is known; the "
    "coming reference is; it is, but the air stays within 0.3 K of the present one until a step comes; the"
    " present one alone is. A dash: not measured."
)


def table(results: Results, names: Sequence[str], reference: str, title: str = "") -> Table:
    """Return one line per row that has run, ranked within equal knowledge.

    names : entries; title : in place of the reference's name
    """
    heads = ("controller", "knows", "seeds", *COLUMNS, "x best", "x sensor", "x equal", "remark")
    remarks = {one.row: one.remark for one in results if one.reference == reference}
    ranked = ranking(results, names, reference)
    rows = tuple((*_cells(results, row, reference), remarks[row]) for row in ranked)
    return Table(title or reference, heads, rows, NOTE)


def parts_table(results: Results, names: Sequence[str], reference: str) -> Table | None:
    """Return what parts of a step of the fan save; None without runs to compare.

    Each of ours with penalty by the clairvoyant of whole steps that may do as much with the coming reference.
    """
    rows = []
    for name, limit in WHOLE.items():
        shared = seeds_of(results, name, reference) & seeds_of(results, limit, reference)
        if name in names and shared:
            mine = [one for one in results if one.seed in shared]
            remark = next(one.remark for one in mine if (one.entry, one.reference) == (name, reference))
            costs = (column(mine, one, reference, "sensor_cost_1") for one in (name, limit))
            rows.append((name, limit, str(len(shared)), spread_text(ratio(*costs), 2), remark))
    note = "Costs at the sensor, seed by seed."
    title = f"{reference}: against a fan of whole steps"
    return Table(title, ("controller", "by", "seeds", "x", "remark"), tuple(rows), note) if rows else None


def ranking(results: Results, names: Sequence[str], reference: str) -> list[str]:
    """Return the rows that have run, by knowledge and then by their cost at the sensor."""

    def place(row: str) -> tuple[int, float]:
        found = regret(results, row, reference, by_sensor=True)
        return _knowledge(row), float("inf") if found is None else found.value

    here = [one for one in results if one.reference == reference]
    return sorted(rows_of(here, names), key=place)


def knowledge(row: str) -> str:
    """Return how much a row of the table knows of what is to come: one of KNOWLEDGE."""
    return KNOWLEDGE[_knowledge(row)]


def _entry(row: str) -> str:
    return row.partition(BY)[0]


@cache
def _knowledge(row: str) -> int:
    entry = entries()[_entry(row)]
    if entry.keeps_band:
        return BAND
    if entry.clairvoyant is not None:
        return PRESENT if entry.rule == "present" else EVERYTHING
    return COMING if entry.preview else PRESENT


def _cells(results: Results, row: str, reference: str) -> Iterator[str]:
    yield row
    yield knowledge(row)
    yield str(len(column(results, row, reference, "mae_true")))
    for figure, digits in COLUMNS.values():
        values = column(results, row, reference, figure)
        yield spread_text(mean_of(values), digits) if values else "-"
    for by_sensor, among_equals in ((False, False), (True, False), (True, True)):
        found = regret(results, row, reference, by_sensor, among_equals)
        yield "-" if found is None else spread_text(found, 2)


def spread_text(mean: Mean, digits: int) -> str:
    """Return a mean with its interval where there is one."""
    value = f"{mean.value:.{digits}f}"
    return value if mean.n == 1 or mean.half == 0.0 else f"{value}+-{mean.half:.{digits}f}"


def times_table(times: Mapping[str, Sequence[DecisionTime]]) -> Table:
    """Decision times by controller: medians over the runs, and the worst p99."""
    rows = tuple(
        (
            name,
            f"{sorted(one.median_ms for one in found)[len(found) // 2]:.1f}",
            f"{max(one.p99_ms for one in found):.1f}",
        )
        for name, found in times.items()
    )
    note = "Wall clock on a shared machine; a language model's without the network."
    return Table("Decision time [ms]", ("controller", "median", "p99, worst run"), rows, note)


def _seed(one: RunResult) -> int:
    return one.seed


def seeds_of(results: Results, row: str, reference: str) -> set[int]:
    """Return the seeds that have run."""
    return {one.seed for one in results if (one.row, one.reference) == (row, reference)}


def references_of(results: Results) -> list[str]:
    """Return the references that have run."""
    return sorted({one.reference for one in results})


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
    return sorted(known, key=lambda one: (one.reference, one.seed, order[one.entry], one.model))


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
        place = f"{one.row}, {one.reference}, seed {one.seed}"
        if (before := runs.get(_run(one))) is None:
            return f"{place}: no such run is kept"
        if found := first_difference(asdict(before), asdict(_round(before, one, tolerance)), place=place):
            return found
    return ""


def _round(saved: RunResult, now: RunResult, tolerance: float) -> RunResult:
    """Return `now` with the saved value of each figure that is within the tolerance."""
    pairs = {name: (value, getattr(now.figures, name)) for name, value in asdict(saved.figures).items()}
    near = {name: a for name, (a, b) in pairs.items() if a is None or abs(a - b) <= tolerance * abs(a)}
    return replace(now, figures=replace(now.figures, **near))


def _run(one: RunResult) -> tuple[str, str, int]:
    return one.row, one.reference, one.seed
