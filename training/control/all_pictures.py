"""Which pictures a comparison has, and which runs they show minute by minute."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from edge.config.settings import LlmSettings
from training.control.comparison import RunResult, references_of
from training.control.energy import energy_picture
from training.control.job import ComparisonJob, read
from training.control.pictures import bars_picture, runs_picture
from training.control.rig import SPARING, entries

DRAWN = {  # picture -> controllers side by side, those that have run
    "": ("MPC-BFGS", "RL-Off", "LLM-HAM-Te0", "MPC", "MPC-Twin", "clairvoyant"),
    "_penalty": ("MPC-BFGS-P", "RL-Off-P", "LLM-HAM-Te0-P", "MPC-P", "MPC-Twin-P", "clairvoyant-P"),
}


def drawn_jobs(references: Sequence[str], seed: int, llm: LlmSettings) -> list[ComparisonJob]:
    """What the pictures show minute by minute, which figures alone do not tell."""
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
