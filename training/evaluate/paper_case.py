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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge.core.errors import DataError
from edge.diagnosis.report.number_text import number
from edge.formats.table import Table
from training.data.datasets import data_sha256, training_runs
from training.evaluate.difference import first_difference
from training.evaluate.paper_case_chamber import Real, real_effects
from training.evaluate.paper_case_models import (
    HAM,
    HAM_GUARDED,
    TWIN,
    TWIN_HELD,
    ImprovedTwin,
    diagnose,
    forecasts,
    improved_twin,
)
from training.evaluate.report import LABELS
from training.evaluate.scores import TrainingScore
from training.models.fit_network import make_deterministic
from training.models.rollout import RolloutErrors
from training.models.study import SCENARIOS, Regime, versions
from training.models.summary import spread

Twins = Mapping[Regime, ImprovedTwin]
NAMES: Mapping[str, str] = {
    "linear": LABELS["linear"],
    "lstm": LABELS["lstm"],
    "pbm": "PBM, bare",
    TWIN: "PBM, improved",
    TWIN_HELD: "the same, as the hybrid holds it",
    "ham": "HAM over the bare PBM",
    HAM: "HAM over the improved PBM",
    HAM_GUARDED: "guarded HAM over the improved PBM",
    "twin": "fitted twin, effects by hand",
    "ham_guarded": "guarded HAM over that twin",
}


def text_of(chamber: Sequence[Real], twins: Twins, scores: Sequence[TrainingScore]) -> str:
    """All tables. scores : of the models of the comparison too"""
    return "\n".join(line for table in tables(chamber, twins, scores) for line in table.text()) + "\n"


def tables(chamber: Sequence[Real], twins: Twins, scores: Sequence[TrainingScore]) -> Iterator[Table]:
    """In the order in which they are read."""
    yield _effects_table(chamber, twins)
    yield _sizes(chamber, twins)
    for regime, twin in twins.items():
        yield waterfall(regime, twin.document)
    yield _errors(twins, scores, "Free-run MAE [K]", lambda score: score.free_run.mae_k)
    yield _errors(twins, scores, "Free-run RMSE [K]", lambda score: score.free_run.rmse_k)
    yield _outside(scores)
    yield _worth(scores)


def waterfall(regime: Regime, document: Mapping[str, Any]) -> Table:
    """Return the gap after each effect."""
    rows = [
        (_step_name(step["effects"]), *(_kelvin(step[f"{role}_rmse_k"]) for role in ("train", "test")))
        for step in document["waterfall"]
    ]
    floor = document["gap"]["noise_floor"]
    rows.append(("noise floor", *(_kelvin(floor[role]) for role in ("train", "test"))))
    numbers = SCENARIOS[regime]
    heads = ("effect added", "training runs", f"scenarios {numbers[0]} to {numbers[-1]}")
    note = (
        f"Each twin has its values fitted anew. {document['seconds']:.0f} s; the noise floor is what a right "
        "twin would miss by: sensor and room noise, unknown heat, mains power."
    )
    return Table(f"The gap, {regime}: RMSE of free runs [K]", heads, tuple(rows), note)


def _effects_table(chamber: Sequence[Real], twins: Twins) -> Table:
    """Return the chamber's effects and the named ones, false names at the end."""
    found = {regime: _effects(twin) for regime, twin in twins.items()}
    real = {item.name: item for item in chamber}
    strangers = [name for own in found.values() for name in own if name not in real]
    rows = []
    for name in (*real, *dict.fromkeys(strangers)):
        rows.append((name, *_truth(real.get(name)), *(_effect_text(own.get(name)) for own in found.values())))
    heads = (
        "effect",
        "in the chamber",
        "shows [K]",
        *(f"named, {twin.runs} runs" for twin in twins.values()),
    )
    counts = ", ".join(f"{regime} {_count(own, real)}" for regime, own in found.items())
    note = (
        f"Named and there: {counts}. The chamber's columns are read from its settings for this table alone; "
        "`shows` is how much the sensors' difference of air and room changes without the effect (RMS over a "
        "training run's profile). The log odds are against the best set without the effect [nat]."
    )
    return Table("What acts in the chamber, and what was named", heads, tuple(rows), note)


def _sizes(chamber: Sequence[Real], twins: Twins) -> Table:
    """Values of what was named, with their intervals, beside the chamber's where it has one such value."""
    real = {(item.name, item.parameter): item for item in chamber}
    found = {regime: _effects(twin) for regime, twin in twins.items()}
    places = dict.fromkeys(
        (name, key, one["unit"])
        for own in found.values()
        for name, effect in own.items()
        for key, one in effect["parameters"].items()
    )
    rows = []
    for name, key, unit in places:
        item = real.get((name, key))
        true = "-" if item is None or item.value is None else number(item.value)
        cells = (_interval(own.get(name), key) for own in found.values())
        rows.append((f"{name} {key}" + (f" [{unit}]" if unit else ""), true, *cells))
    heads = ("value", "chamber", *(f"{twin.runs} runs" for twin in twins.values()))
    note = (
        "With 95 % intervals. The twin is simpler than the chamber: its wall stands for two sheets, films "
        "that bend and radiation, its soil for what exchanges heat with the air within a run; of the biases "
        "of the two sensors runs show the difference alone, so that stands for the chamber's."
    )
    return Table("What was found of each", heads, tuple(rows), note)


def _effects(twin: ImprovedTwin) -> dict[str, Mapping[str, Any]]:
    return {effect["name"]: effect for effect in twin.document["effects"]}


def _count(named: Mapping[str, Any], real: Mapping[str, Real]) -> str:
    there = sum(1 for effect in named.values() if {effect["name"], *effect["alternatives"]} & real.keys())
    return f"{there} of {len(named)}"


def _truth(item: Real | None) -> tuple[str, str]:
    if item is None:
        return "no", "-"
    return "yes" if item.candidate else "yes, has no name", f"{item.shows_k:.3f}"


def _effect_text(effect: Mapping[str, Any] | None) -> str:
    if effect is None:
        return "-"
    return " or ".join([f"yes ({effect['log_odds']:.0f})", *effect["alternatives"]])


def _interval(effect: Mapping[str, Any] | None, key: str) -> str:
    if effect is None:
        return "-"
    one = effect["parameters"][key]
    return f"{number(one['value'])} ({number(one['low'])} to {number(one['high'])})"


def _errors(
    twins: Twins, scores: Sequence[TrainingScore], title: str, value: Callable[[TrainingScore], float]
) -> Table:
    heads = ["model"]
    for numbers in SCENARIOS.values():
        heads += [*(f"scenario {number}" for number in numbers), "mean"]
    rows = []
    for model, label in NAMES.items():
        cells = [cell for regime in SCENARIOS for cell in _cells(scores, model, regime, value)]
        if any(cell != "-" for cell in cells):
            rows.append((label, *cells))
    notes = [
        "Mean ± sd over the seeds; scenarios 1 to 3 interpolate, 4 to 6 extrapolate. Each regime's improved "
        "PBM comes from its own training runs alone. Linear, LSTM, the bare PBM, the HAM over it and the "
        "last two are those of `greenhouse-train evaluate`."
    ]
    notes += [
        f"The hybrids' graph does not hold {', '.join(twin.left_out)} ({regime}): they stand on the improved "
        "PBM without it, its other values fitted again."
        for regime, twin in twins.items()
        if twin.left_out
    ]
    return Table(title, tuple(heads), tuple(rows), " ".join(notes))


def _cells(
    scores: Sequence[TrainingScore], model: str, regime: Regime, value: Callable[[TrainingScore], float]
) -> Iterator[str]:
    columns = []
    for scenario in SCENARIOS[regime]:
        mine = [s for s in scores if (s.model, s.regime, s.scenario) == (model, regime, scenario)]
        columns.append(np.array([value(score) for score in sorted(mine, key=lambda score: score.seed)]))
    for column in (*columns, np.mean(columns, axis=0)):
        yield spread(column) if column.size else "-"


def _outside(scores: Sequence[TrainingScore]) -> Table:
    rows = []
    for model, label in NAMES.items():
        mine = [s for s in scores if s.model == model and s.regime == "extrapolation"]
        inside = [s.mae_inside_k for s in mine if s.mae_inside_k is not None]
        outside = [s.mae_outside_k for s in mine if s.mae_outside_k is not None]
        if inside and outside:
            rows.append((label, f"{np.mean(inside):.3f}", f"{np.mean(outside):.3f}"))
    heads = ("model", "inside [K]", "outside [K]")
    note = (
        "Free-run MAE where the measured temperature was inside the range of the training data, and beyond."
    )
    return Table("Extrapolation, inside and outside the training range", heads, tuple(rows), note)


def _worth(scores: Sequence[TrainingScore]) -> Table:
    """Return the improved base's value to the hybrid, seed by seed."""
    rows = []
    for regime in SCENARIOS:
        for model in (HAM, HAM_GUARDED):
            bare, improved = _by_seed(scores, "ham", regime), _by_seed(scores, model, regime)
            seeds = sorted(bare.keys() & improved.keys())
            before, after = (np.array([own[seed] for seed in seeds]) for own in (bare, improved))
            figures = f"{before.mean():.3f}", f"{after.mean():.3f}", f"{before.mean() / after.mean():.1f}"
            rows.append((f"{regime}, {NAMES[model]}", *figures, f"{(after < before).sum()} of {len(seeds)}"))
    heads = ("mean free-run MAE", "over bare [K]", "over improved [K]", "times less", "seeds with less")
    return Table("What the improved PBM is worth to the hybrid", heads, tuple(rows))


def _by_seed(scores: Sequence[TrainingScore], model: str, regime: Regime) -> dict[int, float]:
    mine = [score for score in scores if score.model == model and score.regime == regime]
    return {
        seed: float(np.mean([score.free_run.mae_k for score in mine if score.seed == seed]))
        for seed in {score.seed for score in mine}
    }


def _step_name(effects: Sequence[str]) -> str:
    return f"+ {effects[-1]}" if effects else "as given: the paper's balance"


def _kelvin(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


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
