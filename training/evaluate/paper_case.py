"""`greenhouse-train paper-case`: the bare physics model told what it lacks, and the hybrid over it anew.

In each regime the twin begins as the paper's balance with no effect at all. `greenhouse twin diagnose` names
what the regime's training runs show to be missing; the regime's scenarios show the gap and have no part in
the choice. The twin that it hands on, and hybrids over it and over the bare one, forecast these scenarios as
all other models did (`greenhouse-train evaluate`, whose figures stand beside). What the simulated chamber has
is read from its own settings afterwards, for the table alone.
"""

import argparse
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge.core.errors import DataError
from training.data.datasets import data_sha256, training_runs
from training.evaluate.difference import first_difference
from training.evaluate.paper_case_chamber import Real, real_effects
from training.evaluate.paper_case_models import ImprovedTwin, diagnose, forecasts, improved_twin
from training.evaluate.paper_case_tables import text_of
from training.evaluate.scores import TrainingScore
from training.models.fit_network import make_deterministic
from training.models.rollout import RolloutErrors
from training.models.study import SCENARIOS, Regime, versions

COMMAND = "greenhouse-train paper-case"
FIGURES, TEXT, PICTURE = "paper_case.json", "paper_case.txt", "waterfall.png"


@dataclass(frozen=True, slots=True)
class PaperCase:
    """All figures that the same twins, runs and seeds give again.

    left_out : effects of the improved twin that a hybrid's graph does not hold, by regime
    """

    command: str
    seeds: tuple[int, ...]
    data_sha256: Mapping[str, str]
    versions: Mapping[str, str]
    left_out: Mapping[str, Sequence[str]]
    chamber: tuple[Real, ...]
    scores: tuple[TrainingScore, ...]


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError, OSError

    arguments : results, out (folders), evaluation (file), seeds, kept_twins, check
    """
    make_deterministic(0)
    folder: Path = arguments.results
    compared = read_scores(arguments.evaluation)
    twins: dict[Regime, ImprovedTwin] = {}
    for regime in SCENARIOS:
        if not (arguments.kept_twins or arguments.check):
            diagnose(regime, folder / regime)
        twins[regime] = improved_twin(regime, folder / regime)
    figures = figures_of(twins, tuple(arguments.seeds), arguments.out)
    text = f"{COMMAND}\n\n" + text_of(figures.chamber, twins, [*compared, *figures.scores])
    print(text, end="")
    if arguments.check:
        return _check(figures, folder / FIGURES)
    (folder / FIGURES).write_text(json_of(figures), encoding="utf-8")
    (folder / TEXT).write_text(text, encoding="utf-8")
    (folder / PICTURE).write_bytes(waterfall_picture({key: twin.document for key, twin in twins.items()}))
    return 0


def figures_of(twins: Mapping[Regime, ImprovedTwin], seeds: tuple[int, ...], out: Path) -> PaperCase:
    """Train, forecast, and read the chamber's settings. out : where the networks are left"""
    return PaperCase(
        COMMAND,
        seeds,
        {regime: data_sha256(training_runs(regime)) for regime in twins},
        versions(),
        {regime: twin.left_out for regime, twin in twins.items()},
        real_effects(),
        tuple(score for twin in twins.values() for score in forecasts(twin, seeds, out)),
    )


def json_of(figures: PaperCase) -> str:
    """All digits, a line for each score and each effect."""
    parts = {
        key: "[\n" + ",\n".join(json.dumps(row) for row in value) + "\n]"
        if key in ("scores", "chamber")
        else json.dumps(value)
        for key, value in asdict(figures).items()
    }
    return "{\n" + ",\n".join(f"{json.dumps(key)}: {text}" for key, text in parts.items()) + "\n}\n"


def read_scores(path: Path) -> list[TrainingScore]:
    """Read the scores in evaluation.json or paper_case.json. Errors: DataError"""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["scores"]
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"{path}: no figures of a comparison: {error}") from error
    return [
        TrainingScore(
            **{
                **row,
                "free_run": RolloutErrors(**row["free_run"]),
                "one_step": RolloutErrors(**row["one_step"]),
            }
        )
        for row in rows
    ]


def _check(figures: PaperCase, path: Path) -> int:
    """0 where the kept figures come out again from the kept twins."""
    kept = json.loads(path.read_text(encoding="utf-8"))
    difference = first_difference(kept, json.loads(json_of(figures)), place=path.name)
    print(difference or "the same as what is kept")
    return 1 if difference else 0


DPI = 80  # the picture lies in the repository
SERIES = (("train", "training runs", "tab:blue", -0.2), ("test", "scenarios", "tab:orange", 0.2))


def waterfall_picture(documents: Mapping[str, Mapping[str, Any]]) -> bytes:
    """PNG of diagnosis.json by regime."""
    most = max(len(document["waterfall"]) for document in documents.values())
    errors = [step["train_rmse_k"] for document in documents.values() for step in document["waterfall"]]
    figure = Figure(figsize=(10, 1.6 + 0.36 * most), layout="constrained")
    panels = figure.subplots(1, len(documents), squeeze=False, sharex=True)[0]
    for axes, (regime, document) in zip(panels, documents.items(), strict=True):
        _draw(axes, document)
        axes.set_title(f"{regime.capitalize()}: the gap, effect by effect")
    panels[0].set_xlim(0.5 * min(errors), 4.0 * max(errors))
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, pil_kwargs={"optimize": True})
    return out.getvalue()


def _draw(axes: Axes, document: Mapping[str, Any]) -> None:
    steps, floor = document["waterfall"], document["gap"]["noise_floor"]
    rows = range(len(steps))
    for role, label, colour, shift in SERIES:
        errors = [step[f"{role}_rmse_k"] for step in steps]
        axes.barh([row + shift for row in rows], errors, 0.38, color=colour, label=label)
        for row, error in zip(rows, errors, strict=True):
            place = (error, row + shift)
            axes.annotate(f"{error:.3g}", place, (3, 0), textcoords="offset points", va="center", fontsize=7)
        axes.axvline(floor[role], color=colour, linestyle=":", linewidth=1.2)
    axes.set_xscale("log")
    axes.set_yticks(rows, [f"+ {step['effects'][-1]}" if step["effects"] else "bare PBM" for step in steps])
    axes.invert_yaxis()
    axes.set_xlabel("RMSE of free runs [K]; dotted: noise floor")
    axes.legend(fontsize="small", loc="lower right")
