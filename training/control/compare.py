"""`greenhouse-train compare`: controllers on the same rig and references, in tables, pictures and findings.

Runs that are kept in the folder of runs are taken, others are done. comparison.json and comparison.txt hold
what the same machine gives again bit for bit, times.json what was measured with a clock. A few controllers
can be done anew, or added, beside the figures that are kept of all others; a few runs be checked against
them.
"""

import argparse
import base64
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path

from edge.config.settings import LlmSettings
from edge.core.errors import DataError
from edge.formats.table import Table
from training.control.comparison import STAND_IN_MODEL, RunResult, references_of, result, table, times_table
from training.control.energy import energy_picture, energy_tables
from training.control.figures import DecisionTime, decision_time
from training.control.job import ComparisonJob, is_kept, read, run_all
from training.control.pictures import bars_picture, runs_picture
from training.control.rig import SPARING, entries
from training.control.saved_figures import (
    FIGURES_FILE,
    TIMES_FILE,
    Times,
    beside,
    first_change,
    json_of,
    read_results,
    read_times,
    times_beside,
    times_json,
)
from training.llm_stand_in.server import StandIn
from training.reports.comparison_report import read_findings, words_as_html

COMMAND = "greenhouse-train compare"
DRAWN = {  # picture -> controllers side by side, those that have run
    "": ("MPC-BFGS", "RL-Off", "LLM-HAM-Te0", "MPC", "MPC-Twin", "clairvoyant"),
    "_penalty": ("MPC-BFGS-P", "RL-Off-P", "LLM-HAM-Te0-P", "MPC-P", "MPC-Twin-P", "clairvoyant-P"),
}
KEPT_URL = "http://kept"  # nobody is asked


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: GreenhouseError

    arguments : controllers (empty: all), references, seeds, runs, results, images (folders), workers, dask,
        kept, beside_kept, llm_url, llm_model, check, tolerance
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
    if not done:
        raise DataError(f"{arguments.runs}: no run is kept there")
    results, times = _figures(done, arguments.runs)
    if arguments.check:
        print(text_of(results, names), end="")
        return _check(results, kept, arguments.tolerance)
    if is_beside:
        names = list(known)
        results = beside(kept, results, names)
        times = times_beside(read_times(arguments.results), times, names)
    print(text_of(results, names), end="")
    _write(results, times, pictures_of(results, [*done, *drawn], arguments.runs, names), names, arguments)
    return 0


@contextmanager
def _endpoint(arguments: argparse.Namespace) -> Iterator[LlmSettings]:
    """Yield the endpoint of the LLM rows: a given server, none for saved runs, else a stand-in of our own."""
    if arguments.kept or arguments.llm_url:
        yield LlmSettings(url=arguments.llm_url or KEPT_URL, model=arguments.llm_model)
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
        results.append(result(job, log))
        times.setdefault(job.entry.name, []).append(decision_time(log))
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
    references = references_of(results)
    tables = [table(results, names, reference) for reference in references]
    return tables + [one for each in references for one in energy_tables(results, names, each)]


def drawn_jobs(references: Sequence[str], seed: int, llm: LlmSettings) -> list[ComparisonJob]:
    """Return the runs that the pictures show minute by minute."""
    known = entries()
    names = [name for side in DRAWN.values() for name in side]
    return [ComparisonJob(known[name], reference, seed, llm) for reference in references for name in names]


def pictures_of(
    results: Sequence[RunResult], jobs: Sequence[ComparisonJob], runs: Path, names: Sequence[str]
) -> dict[str, bytes]:
    """PNG by file name without its ending; runs of the first seed that there is."""
    references = references_of(results)
    labels = {one.entry: f"{one.entry}\n{one.remark}".strip() for one in results}
    pictures = {}
    for reference in references:
        for ending, drawn in DRAWN.items():
            found = _columns(jobs, reference, drawn, runs)
            shown = {labels[name]: columns for name, columns in found.items()}
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
