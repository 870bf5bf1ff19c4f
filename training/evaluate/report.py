"""The comparison of the models as tables, and as one HTML file that needs nothing beside it."""

import base64
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from edge.core.predictor import Floats
from edge.formats.table import Table
from training.evaluate.ablation import EXCESS_K, Base, ByExcess, UnexplainedError
from training.evaluate.resources import ModelCost
from training.evaluate.scores import SwappedModel, TrainingScore, orders
from training.models.saved_training import OURS, PAPER, UNGUARDED
from training.models.study import SCENARIOS, Regime
from training.models.summary import spread

LABELS = {
    "linear": "Linear",
    "pbm": "PBM",
    "lstm": "LSTM",
    "ham": "HAM",
    "pbm_fitted": "PBM, fitted",
    "linear_ambient": "Linear with the room",
    "twin": "fitted twin",
    "lstm_increment": "LSTM of increments",
    "ham_guarded": "HAM over the twin",
    UNGUARDED: "the same, guard off",
}
MODELS = (*PAPER, *OURS, UNGUARDED)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All figures that the same weights and runs give again."""

    scores: tuple[TrainingScore, ...]
    unexplained: tuple[UnexplainedError, ...]
    bases: tuple[Base, ...]
    swapped: tuple[SwappedModel, ...]
    by_excess: tuple[ByExcess, ...]


def tables(found: Evaluation) -> list[Table]:
    """Those of errors, in the order of the report."""
    scores = found.scores
    return [
        _errors(scores, "Free-run MAE [K]", lambda score: score.free_run.mae_k),
        _errors(scores, "One-step MAE [K]", lambda score: score.one_step.mae_k),
        *(_orders(scores, regime) for regime in SCENARIOS),
        _outside(scores),
        _bias(scores),
        _swap_table(found.swapped),
        _by_excess(found.by_excess),
        _unexplained_table(found.unexplained),
        _bases(found.bases),
    ]


_COSTS_NOTE = (
    "Training: wall time on one thread, mean over seeds, and peak resident memory of the process, torch "
    "and all. Loaded and running: pympler's asizeof as in the paper, plus the tensors, which it doesn't "
    "see. Edge: a fresh process without torch that loads the model (networks as ONNX) and forecasts; "
    "latency of one call for 1 and for 42 sequences of 20 steps, median of 50."
)


def costs_table(costs: Sequence[ModelCost]) -> Table:
    """Return the models' costs, the only figures that differ from one evaluation to the next."""
    heads = (
        "model", "training [s]", "peak [MiB]", "loaded [KiB]", "running [KiB]",
        "edge, resident [MiB]", "of it the model [MiB]", "1 x 20 [ms]", "42 x 20 [ms]",
    )  # fmt: skip
    rows = [
        (
            LABELS[cost.model],
            f"{cost.train_s:.2f}",
            f"{cost.train_peak_mib:.0f}",
            f"{cost.loaded_kib:.1f}",
            f"{cost.running_kib:.1f}",
            f"{cost.edge_ran_mib:.1f}",
            f"{cost.edge_ran_mib - cost.edge_before_mib:.1f}",
            f"{cost.edge_one_ms:.2f}",
            f"{cost.edge_batch_ms:.2f}",
        )
        for cost in costs
    ]
    return Table("Cost", heads, tuple(rows), _COSTS_NOTE)


def _errors(scores: Sequence[TrainingScore], title: str, value: Callable[[TrainingScore], float]) -> Table:
    heads = ["model"]
    for numbers in SCENARIOS.values():
        heads += [*(f"scenario {number}" for number in numbers), "mean"]
    rows = []
    for model in MODELS:
        row = [LABELS[model]]
        for regime, numbers in SCENARIOS.items():
            columns = [_by_seed(scores, model, regime, number, value) for number in numbers]
            row += [spread(column) for column in (*columns, np.mean(columns, axis=0))]
        rows.append(tuple(row))
    note = (
        "Mean ± sd over the seeds of a model that has some; scenarios 1 to 3 interpolate, 4 to 6 "
        "extrapolate. The first four are the paper's."
    )
    return Table(title, tuple(heads), tuple(rows), note)


def _by_seed(
    scores: Sequence[TrainingScore],
    model: str,
    regime: Regime,
    scenario: int,
    value: Callable[[TrainingScore], float],
) -> Floats:
    mine = [s for s in scores if (s.model, s.regime, s.scenario) == (model, regime, scenario)]
    return np.array([value(score) for score in sorted(mine, key=lambda score: score.seed)])


def _orders(scores: Sequence[TrainingScore], regime: Regime) -> Table:
    counted = orders(scores, regime).most_common()
    seeds = sum(count for _, count in counted)
    rows = tuple(
        (" < ".join(LABELS[model] for model in order), f"{count} of {seeds}") for order, count in counted
    )
    return Table(f"Order of the paper's four, {regime}", ("best first", "seeds"), rows)


def _outside(scores: Sequence[TrainingScore]) -> Table:
    regime: Regime = "extrapolation"
    rows = []
    for model in MODELS:
        mine = [score for score in scores if score.model == model and score.regime == regime]
        last = [score for score in mine if score.scenario == SCENARIOS[regime][-1]]
        rows.append(
            (
                LABELS[model],
                f"{np.mean([s.mae_inside_k for s in mine if s.mae_inside_k is not None]):.3f}",
                f"{np.mean([s.mae_outside_k for s in mine if s.mae_outside_k is not None]):.3f}",
                f"{np.mean([s.hottest_c for s in last]):.1f}",
                f"{np.mean([s.hottest_measured_c for s in last]):.1f}",
            )
        )
    heads = ("model", "MAE inside [K]", "MAE outside [K]", "hottest, scenario 6 [°C]", "measured [°C]")
    shares = {s.scenario: s.outside for s in scores if s.regime == regime}
    listed = ", ".join(f"{share:.0%} in scenario {number}" for number, share in sorted(shares.items()))
    note = f"Rows whose measured temperature was outside the range of the training data: {listed}."
    return Table("Extrapolation, inside and outside the training range", heads, tuple(rows), note)


def _bias(scores: Sequence[TrainingScore]) -> Table:
    heads = ("model", *(f"scenario {number}" for numbers in SCENARIOS.values() for number in numbers))
    rows = tuple(
        (
            LABELS[model],
            *(
                f"{_by_seed(scores, model, regime, number, lambda score: score.free_run.bias_k).mean():+.3f}"
                for regime, numbers in SCENARIOS.items()
                for number in numbers
            ),
        )
        for model in MODELS
    )
    return Table("Free-run bias, predicted minus measured [K]", heads, rows)


def _swap_table(rows: Sequence[SwappedModel]) -> Table:
    heads = ("trained for", *(f"scenario {number}" for numbers in SCENARIOS.values() for number in numbers))
    cells = tuple((row.regime, *(f"{value:+.3f}" for value in row.bias_k)) for row in rows)
    note = (
        "Both on all test runs: what stays in a column is the run's, what changes with the row the model's."
    )
    return Table("Bias of the fitted twin of either regime [K]", heads, cells, note)


def _by_excess(rows: Sequence[ByExcess]) -> Table:
    heads = ("trained for", *(f"{low:g} to {high:g} K" for low, high in itertools.pairwise(EXCESS_K)))
    cells = tuple((row.regime, *(f"{value:+.3f}" for value in row.bias_k)) for row in rows)
    note = "Free runs over all 15 training runs; no test run."
    return Table("Bias of the fitted twin by the air's excess over the room [K]", heads, cells, note)


def _unexplained_table(rows: Sequence[UnexplainedError]) -> Table:
    note = (
        "Least squares on the training parts, RMS on the validation parts; no test run. With the fan on "
        "T_hat is the first row: of the air's own temperature it keeps a = exp(-F dt / V) = 5e-4."
    )
    cells = tuple((row.known, f"{row.fan_off_k:.3f}", f"{row.fan_on_k:.3f}") for row in rows)
    return Table("What a step leaves unexplained [K]", ("known", "fan off", "fan on"), cells, note)


def _bases(rows: Sequence[Base]) -> Table:
    cells = tuple(
        (row.name, str(row.states), f"{row.alone_mae_k:.3f}", spread(np.array(row.hybrid_mae_k)))
        for row in rows
    )
    note = (
        "The network of the paper's table over a base that holds more and more physics, fitted on the "
        "training parts; free runs over the validation parts, no test run."
    )
    return Table("What the hybrid stands on: MAE [K]", ("base", "states", "alone", "corrected"), cells, note)


TITLE = "Predictive models of the greenhouse, compared"
_STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; font-size: 12.5px; margin: .5em 0 }
th, td { border-bottom: 1px solid #ccc; padding: .25em .6em; text-align: right; vertical-align: top }
th:first-child, td:first-child { text-align: left }
.note { color: #555; font-size: 13px } img { max-width: 100% }
"""
_END = "</body></html>"
FINDINGS = "findings.md"


def report(
    found: Evaluation,
    costs: Sequence[ModelCost],
    pictures: Mapping[str, bytes],
    findings: str,
    controllers: str = "",
) -> str:
    """Return the page.

    pictures : PNG by file name without its ending, in order
    findings : as `words_as_html` takes it; controllers : their part, HTML
    """
    return "\n".join([*_lines(found, costs, pictures, findings), controllers.rstrip("\n"), _END]) + "\n"


def _lines(
    found: Evaluation, costs: Sequence[ModelCost], pictures: Mapping[str, bytes], findings: str
) -> Iterator[str]:
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>'
    yield f"<style>{_STYLE}</style></head><body><h1>{TITLE}</h1>"
    yield "<p>Made by <code>greenhouse-train evaluate</code> from the recorded runs and the kept weights of"
    yield "every seed. Every model forecasts each test run freely from its first 10 rows: its inputs and the"
    yield "room are given, the air temperature is not. Nothing was fitted or chosen on a test run.</p>"
    yield from words_as_html(findings)
    yield "<h2>Figures</h2>"
    for table in (*tables(found), costs_table(costs)):
        yield from table.html()
    yield "<h2>Pictures</h2>"
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def read_findings(results: Path) -> str:
    """Read the sentences that a person has written on a folder's figures; "" where there are none."""
    path = results / FINDINGS
    return path.read_text(encoding="utf-8") if path.exists() else ""


def words_as_html(text: str) -> Iterator[str]:
    """Lines of a text with `# headings`, paragraphs between empty lines, **bold** and *emphasis*."""
    for block in text.strip().split("\n\n"):
        words = escape(block.strip(), quote=False)
        words = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", words)
        words = re.sub(r"\*(.+?)\*", r"<em>\1</em>", words)
        if words:
            yield f"<h2>{words[2:]}</h2>" if words.startswith("# ") else f"<p>{words}</p>"
