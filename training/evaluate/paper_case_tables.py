"""The tables of the paper's case, out of its figures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from edge.diagnosis.report.number_text import number
from edge.formats.table import Table
from training.evaluate.paper_case_chamber import Real
from training.evaluate.paper_case_models import HAM, HAM_GUARDED, TWIN, TWIN_HELD, ImprovedTwin
from training.evaluate.scores import TrainingScore
from training.models.study import SCENARIOS, Regime
from training.reports.report_tables import LABELS, spread

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
