"""`greenhouse-train compare`: controllers on the same rig and references, in tables, pictures and
findings.

Runs that are kept in the folder of runs are taken, others are done. comparison.json and comparison.txt hold
what the same machine gives again bit for bit, times.json what was measured with a clock. A few controllers
can be done anew, or added, beside the figures that are kept of all others; a few runs be checked against
them.

Energy at equal MAE: our controller at several weights gives a curve of energy and MAE. Between two of its
runs the curve is taken as a line, above the curve itself, which is convex: that speaks against ours.
"""

import argparse
import base64
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edge.config.settings import LlmSettings
from edge.core.controller_names import LLM
from edge.core.errors import DataError
from edge.formats.table import Table
from training.control.comparison import (
    BY,
    FIGURES_FILE,
    STAND_IN_MODEL,
    TIMES_FILE,
    Results,
    RunResult,
    Times,
    beside,
    column,
    first_change,
    json_of,
    of_stand_in,
    parts_table,
    read_results,
    read_times,
    references_of,
    result,
    rows_of,
    seeds_of,
    spread_text,
    table,
    times_beside,
    times_json,
    times_table,
    without_stand_in,
)
from training.control.figures import DecisionTime, decision_time, mean_of
from training.control.job import ComparisonJob, is_kept, read, run_all
from training.control.pictures import bars_picture, runs_picture
from training.control.rig import SPARING, entries
from training.evaluate.pictures import png
from training.evaluate.report import read_findings, words_as_html
from training.llm_stand_in import MODEL as STAND_IN
from training.llm_stand_in.server import StandIn

Floats = NDArray[np.float64]
OURS = ("MPC-Twin/early", "MPC-Twin-P/early", *SPARING)
FAMILIES = {  # beginning of a name -> marker, colour
    "clairvoyant": ("*", "black"), "rules": ("P", "tab:gray"), "PID": ("D", "tab:brown"),
    "MPC-BFGS": ("X", "tab:orange"), "MPC": ("s", "tab:purple"), "RL": ("^", "tab:green"),
    "LLM": (".", "tab:blue"),
}  # fmt: skip
HEADS = ("controller", "Wh", "MAE", "ours at its Wh", "less MAE by", "ours at its MAE [Wh]", "less Wh by")
AIRS = {"the true air": "mae_true", "the sensor": "mae_measured"}  # what a MAE [K] is by
NOTE = (
    f"Ours: {', '.join(OURS)}, seed by seed, a line between neighbours. Beside one that spends "
    "more than all of these, or has a larger MAE, stands the best of ours with less; a dash where ours does "
    "not come down to that energy or MAE."
)


def at_most(limit: float, given: Floats, wanted: Floats) -> float:
    """Least `wanted` on the curve through the points (given, wanted) up to `limit`; nan below all of them."""
    order = np.argsort(given, kind="stable")
    given, least = given[order], np.minimum.accumulate(wanted[order])
    return float(np.interp(limit, given, least)) if limit >= given[0] else float("nan")


def energy_tables(results: Results, names: Sequence[str], reference: str) -> list[Table]:
    """One by each air; none where ours has not run at every weight."""
    found = (energy_table(results, names, reference, air) for air in AIRS)
    return [table for table in found if table is not None]


def energy_table(
    results: Results, names: Sequence[str], reference: str, air: str = "the true air"
) -> Table | None:
    """Return a line per row that has run; None where ours has not run at every weight.

    names : entries; air : of AIRS
    """
    rows = []
    for name in rows_of(results, names):
        if name in OURS or name.startswith("clairvoyant"):
            continue
        shared = set.intersection(*(seeds_of(results, one, reference) for one in (name, *OURS)))
        if shared:
            on_these = [one for one in results if one.seed in shared]
            points = _points(on_these, name, reference, AIRS[air])
            rows.append(tuple(_cells(name, points, _curves(on_these, reference, AIRS[air]))))
    title = f"{reference}: at equal energy, at equal MAE by {air}"
    return Table(title, HEADS, tuple(rows), NOTE) if rows else None


def energy_picture(results: Results, names: Sequence[str], references: Sequence[str]) -> bytes:
    """Energy and true MAE of every controller, ours as a curve; a panel per reference."""
    figure = Figure(figsize=(6.4 * len(references), 4.6), layout="constrained")
    for axes, reference in zip(
        figure.subplots(1, len(references), squeeze=False)[0], references, strict=True
    ):
        _draw(axes, results, names, reference)
    return png(figure)


def _cells(name: str, points: Floats, ours: Floats) -> Iterator[str]:
    """points : [S, 2], energy and MAE by seed; ours : [S, 2, W], at each weight"""
    energy, mae = points.T
    yield name
    yield spread_text(mean_of(energy.tolist()), 0)
    yield spread_text(mean_of(mae.tolist()), 3)
    for limits, own, given, wanted, digits in ((energy, mae, 0, 1, 3), (mae, energy, 1, 0, 0)):
        found = [at_most(x, curve[given], curve[wanted]) for x, curve in zip(limits, ours, strict=True)]
        yield _spread(found, digits)
        yield _spread(own - np.array(found), digits)


def _spread(values: Sequence[float] | Floats, digits: int) -> str:
    listed = np.asarray(values).tolist()
    return spread_text(mean_of(listed), digits) if np.isfinite(listed).all() else "-"


def _points(results: Results, name: str, reference: str, error: str = "mae_true") -> Floats:
    """[S, 2]"""
    energy, mae = (column(results, name, reference, figure) for figure in ("energy_wh", error))
    return np.array([energy, mae]).T


def _curves(results: Results, reference: str, error: str) -> Floats:
    """[S, 2, W]"""
    return np.stack([_points(results, name, reference, error) for name in OURS], axis=-1)


def _draw(axes: Axes, results: Results, names: Sequence[str], reference: str) -> None:
    ours = np.array(
        [points.mean(axis=0) for name in OURS if len(points := _points(results, name, reference))]
    )
    if len(ours):
        energy, mae = ours[np.argsort(ours[:, 0])].T
        axes.plot(energy, mae, "o-", color="tab:red", label="MPC-Twin, by weight of effort")
    seen: set[str] = set()
    for name in rows_of(results, names):
        points = _points(results, name, reference)
        if name in OURS or not len(points):
            continue
        family = next(family for family in FAMILIES if name.startswith(family))
        marker, colour = FAMILIES[family]
        label = "" if family in seen else family
        seen.add(family)
        axes.plot(*points.mean(axis=0), marker, color=colour, label=label, markersize=6, alpha=0.8)
    axes.set_xlabel("energy of the heater [Wh]")
    axes.set_ylabel("MAE, true air [K]")
    axes.set_ylim(bottom=0.0)
    axes.set_title(reference.replace("_", " "))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


COMMAND = "greenhouse-train compare"
DRAWN = {  # picture -> controllers side by side, those that have run
    "": ("MPC-BFGS", "RL-Off", "LLM-HAM-Te0", "MPC", "MPC-Twin", "clairvoyant"),
    "_penalty": ("MPC-BFGS-P", "RL-Off-P", "LLM-HAM-Te0-P", "MPC-P", "MPC-Twin-P", "clairvoyant-P"),
}
KEPT_URL = "http://kept"  # nobody is asked


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: GreenhouseError

    arguments : controllers (empty: all), references, seeds, runs, results, images (folders), workers, dask,
        kept, beside_kept, llm_url, llm_model, llm_exchanges, llm_answer_tokens, check, tolerance
    """
    known = entries()
    unknown = set(arguments.controllers or ()) - known.keys()
    if unknown:
        raise DataError(f"--controllers: there is no {sorted(unknown)}; known: {sorted(known)}")
    names = arguments.controllers or list(known)
    # Before anything is run: a folder without figures is told now, not after hours.
    kept = read_results(arguments.results) if arguments.check or arguments.beside_kept else []
    with _endpoint(arguments) as llm:
        asked = [
            ComparisonJob(known[name], reference, seed, llm)
            for reference in arguments.references
            for seed in arguments.seeds
            for name in names
        ]
        is_beside = arguments.beside_kept and not arguments.check
        drawn = drawn_jobs(arguments.references, min(arguments.seeds), llm) if is_beside else []
        if not arguments.kept:
            missing = [*asked, *(job for job in drawn if job not in asked)]
            run_all(missing, arguments.runs, arguments.workers, arguments.dask)
    done = [job for job in asked if is_kept(job, arguments.runs)]
    if not done and not is_beside:
        raise DataError(f"{arguments.runs}: no run is kept there")
    results, times = _figures(done, arguments.runs)
    if arguments.check:
        print(text_of(results, names), end="")
        return _check(results, kept, arguments.tolerance)
    if is_beside:
        names = list(known)
        results = beside(kept, results, names)
        times = times_beside(read_times(arguments.results), times, rows_of(without_stand_in(results), names))
    print(text_of(results, names), end="")
    shown = [*done, *(job for job in drawn if is_kept(job, arguments.runs))]
    _write(results, times, pictures_of(results, shown, arguments.runs, names), names, arguments)
    return 0


@contextmanager
def _endpoint(arguments: argparse.Namespace) -> Iterator[LlmSettings]:
    """Yield the endpoint of the LLM rows: a given server, none for saved runs, else a stand-in of our own."""
    if arguments.kept or arguments.llm_url:
        yield LlmSettings(
            url=arguments.llm_url or KEPT_URL,
            model=arguments.llm_model,
            exchanges=arguments.llm_exchanges,
            answer_tokens=arguments.llm_answer_tokens,
        )
        return
    if arguments.llm_model != STAND_IN_MODEL:
        raise DataError(f"--llm-model: {arguments.llm_model} needs --llm-url, the server that has it")
    with StandIn() as stand_in:
        yield LlmSettings(url=stand_in.url, model=STAND_IN_MODEL)


def _figures(jobs: Sequence[ComparisonJob], runs: Path) -> tuple[list[RunResult], Times]:
    results: list[RunResult] = []
    times: dict[str, list[DecisionTime]] = {}
    for job in jobs:
        log = read(job, runs)
        results.append(found := result(job, log))
        if found.model != STAND_IN:
            times.setdefault(found.row, []).append(decision_time(log))
    return results, times


def _write(
    results: Sequence[RunResult],
    times: Times,
    pictures: Mapping[str, bytes],
    names: Sequence[str],
    arguments: argparse.Namespace,
) -> None:
    folder: Path = arguments.results
    for place in (folder, arguments.images):
        place.mkdir(parents=True, exist_ok=True)
    print("\n".join(times_table(times).text()))
    (folder / TIMES_FILE).write_text(times_json(times), encoding="utf-8")
    (folder / "times.txt").write_text("\n".join(times_table(times).text()), encoding="utf-8")
    (folder / FIGURES_FILE).write_text(json_of(results), encoding="utf-8")
    (folder / "comparison.txt").write_text(text_of(results, names), encoding="utf-8")
    for name, content in pictures.items():
        (arguments.images / f"{name}.png").write_bytes(content)


def _check(results: Sequence[RunResult], kept: Sequence[RunResult], tolerance: float) -> int:
    difference = first_change(kept, results, tolerance)
    near = f"within {100.0 * tolerance:g} % of" if tolerance else "the same as"
    print(difference or f"{len(results)} of the {len(kept)} runs: {near} what is kept")
    return 1 if difference else 0


def text_of(results: Sequence[RunResult], names: Sequence[str]) -> str:
    """Return the tables."""
    lines = [line for each in _tables(results, names) for line in each.text()]
    return "\n".join([COMMAND, "", *lines]) + "\n"


def kept_section(folder: Path, images: Path) -> str:
    """Return the controllers' part of the report from the saved figures and pictures, "" without any."""
    if not (folder / FIGURES_FILE).exists():
        return ""
    results = read_results(folder)
    pictures = {path.stem: path.read_bytes() for path in sorted(images.glob("control_*.png"))}
    return section(
        results, list(dict.fromkeys(one.entry for one in results)), pictures, read_findings(folder)
    )


def section(
    results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes], findings: str
) -> str:
    """Return the controllers' part of the report, as HTML. findings : as `words_as_html` takes it"""
    return "\n".join(_section(results, names, pictures, findings)) + "\n"


def _section(
    results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes], findings: str
) -> Iterator[str]:
    yield "<h1>Controllers on the virtual rig, compared</h1>"
    yield f"<p>Made by <code>{COMMAND}</code>: the whole daemon with each controller, the same rooms.</p>"
    yield from words_as_html(findings)
    for each in _tables(results, names):
        yield from each.html()
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def _tables(results: Sequence[RunResult], names: Sequence[str]) -> list[Table]:
    references, ranked, scripted = references_of(results), without_stand_in(results), of_stand_in(results)
    tables = [table(ranked, names, each) for each in references]
    tables += [one for each in references if (one := parts_table(ranked, names, each)) is not None]
    tables += [one for each in references for one in energy_tables(ranked, names, each)]
    # Beside the limits, which every table needs that ranks by them.
    limits = [one for one in ranked if one.entry not in LLM]
    only = [name for name in names if name in LLM]
    for each in references_of(scripted):
        tables.append(table([*limits, *scripted], only, each, f"{each}: {STAND_IN}"))
    return tables


def drawn_jobs(references: Sequence[str], seed: int, llm: LlmSettings) -> list[ComparisonJob]:
    """Return the runs that the pictures show minute by minute; a script's are no language model's."""
    known = entries()
    names = [name for side in DRAWN.values() for name in side]
    if llm.model == STAND_IN_MODEL:
        names = [name for name in names if name not in LLM]
    return [ComparisonJob(known[name], reference, seed, llm) for reference in references for name in names]


def pictures_of(
    results: Sequence[RunResult], jobs: Sequence[ComparisonJob], runs: Path, names: Sequence[str]
) -> dict[str, bytes]:
    """PNG by file name without its ending; runs of the first seed that there is."""
    results = without_stand_in(results)
    references = references_of(results)
    labels = {one.entry: one.row.replace(BY, "\n") for one in results}
    pictures = {}
    for reference in references:
        for ending, drawn in DRAWN.items():
            found = _columns(jobs, reference, drawn, runs)
            shown = {labels.get(name, name): columns for name, columns in found.items()}
            if shown:
                title = f"{reference.replace('_', ' ')}, {'with' if ending else 'without'} penalty"
                pictures[f"control_{reference}{ending}"] = runs_picture(title, shown)
    shown_names = [name for name in names if name not in SPARING and not name.endswith("/unbounded")]
    pictures["control_mae"] = bars_picture(results, shown_names, references)
    pictures["control_energy"] = energy_picture(results, shown_names, references)
    return pictures


def _columns(
    jobs: Sequence[ComparisonJob], reference: str, drawn: Sequence[str], runs: Path
) -> dict[str, Mapping]:  # type: ignore[type-arg]
    shown = {}
    for name in drawn:
        mine = [job for job in jobs if (job.entry.name, job.reference) == (name, reference)]
        if mine:
            shown[name] = read(min(mine, key=lambda job: job.seed), runs).columns
    return shown
