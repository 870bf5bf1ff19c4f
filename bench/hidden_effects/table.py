"""The score as tables: every figure beside its target, then by kind and by effect; text and Markdown."""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from bench.hidden_effects.run_cases import OURS
from bench.hidden_effects.score_case import add_place
from edge.formats.table import Table

Document = Mapping[str, Any]
Rows = list[list[str]]


class TableLine(NamedTuple):
    """A row of the first table. met : whether a value meets the target, None where there is none."""

    figure: str
    name: str
    target: str = ""
    met: Callable[[float], bool] | None = None


def _least(value: float) -> Callable[[float], bool]:
    return lambda found: found >= value


def _most(value: float) -> Callable[[float], bool]:
    return lambda found: found <= value


LINES = (
    TableLine("naming", "one effect: first name right", "0.97", _least(0.97)),
    TableLine("exact_single", "one effect: exact set", "0.93", _least(0.93)),
    TableLine("exact_pair", "two effects: exact set", "0.90", _least(0.90)),
    TableLine("weak", "weak: first name right", "0.85", _least(0.85)),
    TableLine("hard", "hard logs: first name right", "0.85", _least(0.85)),
    TableLine("bare_found", "bare PBM: share found", "0.90", _least(0.90)),
    TableLine("bare_true", "bare PBM: share of named that are true", "1.00", _least(1.0)),
    TableLine("shown", "hidden effects that the runs show at all"),
    TableLine("found_shown", "of these found: one or two effects, weak, hard"),
    TableLine("bare_found_shown", "of these found: bare PBM"),
    TableLine("false_alarms", "nothing missing: false alarms", "<= 0.03", _most(0.03)),
    TableLine("unknown", "outside the library: says unknown", "0.90", _least(0.90)),
    TableLine("dependence", "outside the library: true dependence", "0.85", _least(0.85)),
    TableLine("unknown_wrongly", "unknown said wrongly", "<= 0.03", _most(0.03)),
    TableLine("told", "alias class told honestly", "0.90", _least(0.90)),
    TableLine("told_rivals", "the same, of effects that have rivals"),
    TableLine("coverage", "95 % intervals that cover", "0.92..0.98", lambda found: 0.92 <= found <= 0.98),
    TableLine("shrink", "gap shrink 0.9 or more", "0.95", _least(0.95)),
    TableLine("shrink_mean", "gap shrink, mean (below 0 as 0)"),
    TableLine("ratio_median", "RMSE after / noise floor, median", "1.02", _most(1.02)),
    TableLine("ratio_p90", "RMSE after / noise floor, p90", "1.25", _most(1.25)),
    TableLine("seconds_median", "seconds per case, median", "5", _most(5.0)),
    TableLine("seconds_worst", "seconds per case, worst", "60", _most(60.0)),
    TableLine("cpu_median", "seconds of processors, median"),
    TableLine("failed", "no answer at all"),
)
KIND_COLUMNS = {
    "first_right": "first name", "exact": "exact set", "told": "alias class", "coverage": "intervals",
    "shrink": "shrink >= 0.9", "ratio_median": "RMSE / floor", "seconds_median": "seconds",
}  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    """Print the tables of a score again."""
    parser = argparse.ArgumentParser(prog="python -m bench.hidden_effects table", description=main.__doc__)
    add_place(parser)
    parser.add_argument("--markdown", action="store_true")
    arguments = parser.parse_args(words)
    path = arguments.results / arguments.suite / arguments.split / "score.json"
    if not path.exists():
        print(f"{path}: no score: run `python -m bench.hidden_effects score` first")
        return 2
    content = json.loads(path.read_text(encoding="utf-8"))
    print(markdown(content) if arguments.markdown else text(content), end="")
    return 0


def text(content: Document) -> str:
    """All tables, columns aligned."""
    return "\n".join(line for table in _tables(content) for line in table.text())


def markdown(content: Document) -> str:
    """All tables as Markdown has them."""
    return "\n\n".join("\n".join(table.markdown()) for table in _tables(content)) + "\n"


def _tables(content: Document) -> list[Table]:
    title = f"{content['suite']}, {content['split']}: {content['cases']} cases, shares with 95 % intervals"
    tables = [(title, _figures(content))]
    for name, own in content["solvers"].items():
        if name == OURS:
            tables += [
                ("By kind", _kinds(own)),
                ("By effect: first name right, or unknown said", _effects(own)),
            ]
    return [
        Table(name, tuple(rows[0]), tuple(map(tuple, rows[1:])), words=True)
        for name, rows in tables
        if len(rows) > 1
    ]


def _figures(content: Document) -> Rows:
    solvers = content["solvers"]
    answered = [f"{name} ({own['cases']})" for name, own in solvers.items()]
    rows = [["figure", "target", "met", *answered]]
    for line in LINES:
        found = [own["figures"][line.figure] for own in solvers.values()]
        rows.append([line.name, line.target, _goal_mark(line, solvers), *map(_figure, found)])
    return rows


def _goal_mark(line: TableLine, solvers: Mapping[str, Any]) -> str:
    value = _value(solvers[OURS]["figures"][line.figure]) if OURS in solvers else None
    if line.met is None or value is None:
        return ""
    return "yes" if line.met(value) else "no"


def _kinds(own: Mapping[str, Any]) -> Rows:
    rows = [["kind", *KIND_COLUMNS.values()]]
    rows += [[kind, *(_figure(found[key]) for key in KIND_COLUMNS)] for kind, found in own["by_kind"].items()]
    return rows


def _effects(own: Mapping[str, Any]) -> Rows:
    return [["effect", "share"], *([name, _figure(found)] for name, found in own["by_effect"].items())]


def _figure(found: Any) -> str:
    """`0.97 [0.92, 0.99] of 100`, `1.02`, or `-` where no case tells."""
    value = _value(found)
    if value is None:
        return "-"
    if not isinstance(found, Mapping):
        return f"{value:.2f}"
    return f"{value:.2f} [{found['low']:.2f}, {found['high']:.2f}] of {found['cases']}"


def _value(found: Any) -> float | None:
    value: float | None = found["value"] if isinstance(found, Mapping) else found
    return value
