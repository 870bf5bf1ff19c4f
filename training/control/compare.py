"""`greenhouse-train compare`: controllers on the same rig and references, in tables, pictures and findings.

Runs that are kept in the folder of runs are taken, others are done. comparison.json and comparison.txt hold
what the same machine gives again bit for bit, times.json what was measured with a clock.
"""

import argparse
import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from html import escape
from pathlib import Path

from edge.errors import DataError
from edge.settings import LlmSettings
from training.control.comparison import STAND_IN_MODEL, Result, column, result, table, times_table
from training.control.effort import FAMILIES, lines, training_s
from training.control.energy import energy_picture, energy_table
from training.control.figures import DecisionTime, Figures, decision_time
from training.control.findings import beyond, findings
from training.control.job import Job, is_kept, read
from training.control.pictures import bars_picture, radar_picture, runs_picture
from training.control.rig import SPARING, entries
from training.control.runner import run_all
from training.control.spread import mean_of
from training.evaluate import first_difference
from training.llm_stand_in.server import StandIn
from training.report import put_section
from training.report_findings import Finding
from training.report_table import Table, as_html, as_text

COMMAND = "greenhouse-train compare"
KEPT_URL = "http://kept"  # nobody is asked
DRAWN = {  # picture -> controllers side by side, those that have run
    "": ("MPC-BFGS", "RL-Off", "LLM-HAM-Te0", "MPC", "MPC-Twin", "clairvoyant"),
    "_penalty": ("MPC-BFGS-P", "RL-Off-P", "LLM-HAM-Te0-P", "MPC-P", "MPC-Twin-P", "clairvoyant-P"),
}


def run(arguments: argparse.Namespace) -> int:
    """The exit code. Errors: GreenhouseError

    arguments : controllers (empty: all), references, seeds, runs, results, images (folders), workers, kept,
        llm_url, llm_model, check
    """
    known = entries()
    unknown = set(arguments.controllers or ()) - known.keys()
    if unknown:
        raise DataError(f"--controllers: there is no {sorted(unknown)}; known: {sorted(known)}")
    names = arguments.controllers or list(known)
    with _endpoint(arguments) as llm:
        jobs = [
            Job(known[name], reference, seed, llm)
            for reference in arguments.references
            for seed in arguments.seeds
            for name in names
        ]
        if not arguments.kept:
            run_all(jobs, arguments.runs, arguments.workers)
    done = [job for job in jobs if is_kept(job, arguments.runs)]
    if not done:
        raise DataError(f"{arguments.runs}: no run is kept there")
    results = [result(job, read(job, arguments.runs)) for job in done]
    print(text_of(results, names), end="")
    if arguments.check:
        return _check(results, arguments.results)
    _write(results, done, names, arguments)
    return 0


@contextmanager
def _endpoint(arguments: argparse.Namespace) -> Iterator[LlmSettings]:
    """Where the LLM rows ask: a given server, nobody for kept runs, else a stand-in of our own."""
    if arguments.kept or arguments.llm_url:
        yield LlmSettings(url=arguments.llm_url or KEPT_URL, model=arguments.llm_model)
        return
    if arguments.llm_model != STAND_IN_MODEL:
        raise DataError(f"--llm-model: {arguments.llm_model} needs --llm-url, the server that has it")
    with StandIn() as stand_in:
        yield LlmSettings(url=stand_in.url, model=STAND_IN_MODEL)


def json_of(results: Sequence[Result]) -> str:
    """All digits, a run on each line."""
    return "[\n" + ",\n".join(json.dumps(asdict(one)) for one in results) + "\n]\n"


def results_of(text: str) -> list[Result]:
    """What `json_of` wrote."""
    return [Result(**{**row, "figures": Figures(**row["figures"])}) for row in json.loads(text)]


def text_of(results: Sequence[Result], names: Sequence[str]) -> str:
    """The tables, and the findings in words."""
    references = _references(results)
    told = [COMMAND, ""]
    told += [line for each in _tables(results, names) for line in as_text(each)]
    for paper, found in _by_paper(results, references).items():
        told += [paper, *(f"    {reference}: {one.verdict}. {one.here}" for reference, one in found.items())]
    return "\n".join([*told, *beyond(results, references)]) + "\n"


def pictures_of(
    results: Sequence[Result], jobs: Sequence[Job], runs: Path, names: Sequence[str]
) -> dict[str, bytes]:
    """PNG by file name without its ending; runs of the first seed that there is."""
    references = _references(results)
    labels = {one.entry: f"{one.entry}\n{one.remark}".strip() for one in results}
    pictures = {}
    for reference in references:
        for ending, drawn in DRAWN.items():
            found = _columns(jobs, reference, drawn, runs)
            shown = {labels[name]: columns for name, columns in found.items()}
            if shown:
                title = f"{reference.replace('_', ' ')}, {'with' if ending else 'without'} penalty"
                pictures[f"control_{reference}{ending}"] = runs_picture(title, shown)
    pictures["control_mae"] = bars_picture(results, [n for n in names if n not in SPARING], references)
    pictures["control_energy"] = energy_picture(results, names, references)
    if families := _radar(results, references):
        pictures["control_radar"] = radar_picture(families)
    return pictures


def section(results: Sequence[Result], names: Sequence[str], pictures: Mapping[str, bytes]) -> str:
    """The controllers' part of the report, as HTML."""
    return "\n".join(_section(results, names, pictures)) + "\n"


def _section(results: Sequence[Result], names: Sequence[str], pictures: Mapping[str, bytes]) -> Iterator[str]:
    references = _references(results)
    yield "<h1>Controllers on the virtual rig, compared</h1>"
    yield f"<p>Made by <code>{COMMAND}</code>: the whole daemon with each controller, the same rooms.</p>"
    yield "<h2>The paper's findings and ours</h2><table class=words>"
    heads = "".join(f"<th>{reference.replace('_', ' ')}</th>" for reference in references)
    yield f"<tr><th>the paper</th>{heads}</tr>"
    for paper, found in _by_paper(results, references).items():
        cells = "".join(_cell(found.get(reference)) for reference in references)
        yield f"<tr><td>{escape(paper)}</td>{cells}</tr>"
    yield "</table><h2>Beyond the paper</h2>"
    yield from (f"<p>{escape(text)}</p>" for text in beyond(results, references))
    for each in (*_tables(results, names), _effort_table()):
        yield from as_html(each)
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def _by_paper(results: Sequence[Result], references: Sequence[str]) -> dict[str, dict[str, Finding]]:
    """What the paper says -> reference -> what is so on it."""
    told: dict[str, dict[str, Finding]] = {}
    for reference in references:
        for finding in findings(results, reference):
            told.setdefault(finding.paper, {})[reference] = finding
    return told


def _cell(finding: Finding | None) -> str:
    return "<td></td>" if finding is None else f"<td><b>{finding.verdict}</b>. {escape(finding.here)}</td>"


def _tables(results: Sequence[Result], names: Sequence[str]) -> list[Table]:
    references = _references(results)
    tables = [table(results, names, reference) for reference in references]
    return tables + [one for each in references if (one := energy_table(results, names, each)) is not None]


def _effort_table() -> Table:
    rows = tuple(
        (family.name, str(lines(family.files)), str(len(family.tuned)), str(family.knowledge), family.why)
        for family in FAMILIES
        if lines(family.files)
    )
    heads = ("family", "lines", "settings tuned", "knowledge 1-5", "why")
    return Table("What it takes", heads, rows, "Counted by python -m training.control.effort.")


def _radar(
    results: Sequence[Result], references: Sequence[str]
) -> dict[str, tuple[float, float, float, float]]:
    rows = {}
    for family in FAMILIES:
        found = [mean_of(v).value for r in references if (v := column(results, family.entry, r, "mae_true"))]
        if found:
            mae = sum(found) / len(found)
            remark = next((one.remark for one in results if one.entry == family.entry), "")
            name = f"{family.name} ({remark})" if remark else family.name
            rows[name] = (mae, training_s(family), float(lines(family.files)), float(family.knowledge))
    return rows


def _columns(jobs: Sequence[Job], reference: str, drawn: Sequence[str], runs: Path) -> dict[str, Mapping]:  # type: ignore[type-arg]
    shown = {}
    for name in drawn:
        mine = [job for job in jobs if (job.entry.name, job.reference) == (name, reference)]
        if mine:
            shown[name] = read(min(mine, key=lambda job: job.seed), runs).columns
    return shown


def _references(results: Sequence[Result]) -> list[str]:
    return sorted({one.reference for one in results})


def _write(
    results: Sequence[Result], jobs: Sequence[Job], names: Sequence[str], arguments: argparse.Namespace
) -> None:
    pictures = pictures_of(results, jobs, arguments.runs, names)
    folder: Path = arguments.results
    for place in (folder, arguments.images):
        place.mkdir(parents=True, exist_ok=True)
    times: dict[str, list[DecisionTime]] = {}
    for job in jobs:
        times.setdefault(job.entry.name, []).append(decision_time(read(job, arguments.runs)))
    print("\n".join(as_text(times_table(times))))
    kept = {name: [asdict(one) for one in found] for name, found in times.items()}
    (folder / "times.json").write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    (folder / "times.txt").write_text("\n".join(as_text(times_table(times))), encoding="utf-8")
    (folder / "comparison.json").write_text(json_of(results), encoding="utf-8")
    (folder / "comparison.txt").write_text(text_of(results, names), encoding="utf-8")
    made = section(results, names, pictures)
    (folder / "section.html").write_text(made, encoding="utf-8")
    put_section(folder.parent / "report.html", made)
    for name, content in pictures.items():
        (arguments.images / f"{name}.png").write_bytes(content)


def _check(results: Sequence[Result], folder: Path) -> int:
    kept = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    difference = first_difference(kept, json.loads(json_of(results)), place="comparison.json")
    print(difference or "the same as what is kept")
    return 1 if difference else 0
