"""python -m tools.reference FOLDER: the manual's Reference, written from the code itself.

Every command, setting, MQTT topic, table, environment variable, signal and physical effect comes from the
place where the program has it. What only a person can say, such as the meaning of a column, stands in
`reference_words.py`; a name without words, and words without a name, are errors.
"""

import argparse
import inspect
import json
import os
import re
import sqlite3
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, fields
from datetime import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import edge.__main__ as greenhouse
import training.__main__ as greenhouse_train
from edge.commands import orders
from edge.config.settings import MqttSettings, ReferenceSettings, Settings
from edge.core.hard_limits import __file__ as hard_limits_file
from edge.core.names import ACTUATORS, SIGNALS
from edge.formats.cross_check import Rule, Section
from edge.mqtt import commands as mqtt_commands
from edge.mqtt.topics import Topic, Topics
from edge.storage.schema import MIGRATIONS, migrate
from edge.tick.faults import FAILURES
from edge.twin.effects.library import EFFECTS
from tools import reference_words as words

ROOT = Path(__file__).parent.parent
HELP_COLUMNS = "88"  # of a help text, as wide as the manual's page
VARIABLE = re.compile(r"environ(?:\.get\(|\.setdefault\(|\[)\s*[\"']([A-Z_]+)[\"']")
NAMED_VARIABLE = re.compile(r"^[A-Z_]+ = [\"'](GREENHOUSE_[A-Z_]+)[\"']", re.MULTILINE)
Table = Sequence[Sequence[object]]


def commands() -> str:
    """Return the help of every command of `greenhouse` and `greenhouse-train`, actions included."""
    lines = ["# Commands", "", "`greenhouse COMMAND --help` prints the same.", ""]
    with patch.dict(os.environ, {"COLUMNS": HELP_COLUMNS}):
        for heading, names in greenhouse.GROUPS.items():
            lines += [f"## {heading}", ""]
            for name in names:
                lines += _helps(f"greenhouse {name}", _subparsers(greenhouse.parser_for(name))[name])
        lines += ["## greenhouse-train", "", "Off the rig: needs `pip install . ./training`.", ""]
        for name, parser in _subparsers(greenhouse_train._parser()).items():
            lines += _helps(f"greenhouse-train {name}", parser)
    return "\n".join(lines)


def _helps(title: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    yield from (f"### {title}", "", "```text", parser.format_help().rstrip(), "```", "")
    for name, action in _subparsers(parser).items():
        yield from _helps(f"{title} {name}", action)


def _subparsers(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    found = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return found[0].choices if found else {}


def help_of(command: Sequence[str]) -> str:
    """Return the help of a command as it is typed. Raises: KeyError for an unknown one"""
    program, *rest = command
    main_ = greenhouse_train._parser() if program == "greenhouse-train" else greenhouse.parser_for(rest[0])
    parser = _subparsers(main_)[rest[0]] if rest and not rest[0].startswith("-") else main_
    for word in rest[1:]:
        parser = _subparsers(parser).get(word, parser)
    return parser.format_help()


def command_names() -> set[str]:
    """Return the names of all commands of `greenhouse`."""
    return {*greenhouse.COMMANDS, *orders.ORDERS}


def settings() -> str:
    """Return every key of edge.yaml with unit, range, default and meaning."""
    lines = ["# Settings", ""]
    lines += ["Every key of `edge.yaml`. Leave out what may stay as it is; an unknown key is an error.", ""]
    lines += ["`hard` marks a limit that stands in the code and that no configuration widens.", ""]
    own = [item for item in fields(Settings) if not isinstance(getattr(Settings(), item.name), Section)]
    lines += ["## Top level", "", *_keys(Settings(), own)]
    for item in fields(Settings):
        section = getattr(Settings(), item.name)
        if isinstance(section, Section):
            lines += [f"## {item.name}", "", (type(section).__doc__ or "").strip(), ""]
            lines += _keys(section, fields(section))
    lines += ["## Hard limits", "", *_hard_limits()]
    return "\n".join(lines)


def _keys(section: Section, items: "Iterable[Field[Any]]") -> list[str]:
    rows = list(_key_rows(section, items, ""))
    return table(("key", "default", "unit", "allowed", "meaning"), rows)


def _key_rows(section: Section, items: "Iterable[Field[Any]]", prefix: str) -> Iterator[Sequence[object]]:
    for item in items:
        value = getattr(section, item.name)
        if isinstance(value, Section):
            yield from _key_rows(value, fields(value), f"{prefix}{item.name}.")
        else:
            rule: Rule = item.metadata["rule"]
            meaning = f"{rule.doc}; one item: `{rule.example}`" if rule.example else rule.doc
            shown = _yaml(value)
            yield f"`{prefix}{item.name}`", f"`{shown}`", rule.unit, _allowed_text(rule, value), meaning


def _allowed_text(rule: Rule, value: object) -> str:
    if rule.choices:
        return ", ".join(f"`{choice}`" for choice in rule.choices)
    if isinstance(value, bool):
        return "`true`, `false`"
    if rule.low > float("-inf"):
        return f"{rule.low:g} to {rule.high:g}{' (hard)' if rule.hard else ''}"
    return f"`{rule.pattern}`" if rule.pattern else ""


def _yaml(value: object) -> str:
    return f'"{value:%H:%M}"' if isinstance(value, time) else json.dumps(value, default=list)


def _hard_limits() -> list[str]:
    lines = Path(hard_limits_file).read_text(encoding="utf-8").splitlines()
    found = [re.match(r"([A-Z_0-9, ]+) = ([^#]+?)(?:  # (.*))?$", line) for line in lines]
    return table(
        ("constant", "value", "reason"), [(f"`{m[1]}`", f"`{m[2]}`", m[3] or "") for m in found if m]
    )


def topics() -> str:
    """Return every MQTT topic, and the request that an example of each command makes."""
    usual = Topics.of(MqttSettings())
    published = {
        name: getattr(usual, name) if isinstance(getattr(usual, name), str) else None
        for name in [*(item.name for item in fields(Topics)), *_topics(Topics)]
    }
    rows = [
        (f"`{topic}`", "yes" if topic in usual.retained else "", _topic_meaning(name))
        for name, topic in published.items()
        if topic is not None and name != "root"
    ]
    rows += [(f"`{usual.root}/history/{name}`", "", text) for name, text in words.HISTORY_TOPICS.items()]
    # The parser itself makes the requests, so that the page cannot promise what the daemon refuses.
    examples = _same(words.PAYLOADS, mqtt_commands.COMMANDS, "MQTT command")
    received = []
    for what, payload in examples.items():
        request = mqtt_commands.parse(what, payload.encode(), ReferenceSettings())
        received.append(
            (f"`{usual.command(what)}`", f"`{payload}`" if payload else "(empty)", f"`{json.dumps(request)}`")
        )
    lines = ["# MQTT topics", "", f"`<rig>` is prefix and name, usually `{usual.root}`.", ""]
    lines += ["## Published", "", *table(("topic", "retained", "content"), rows)]
    lines += ["## Received", "", "Each command is answered on "
              f"`{usual.reply}`. The request is what the daemon makes of the example.", ""]  # fmt: skip
    lines += table(("topic", "example of a payload", "request"), received)
    return "\n".join(lines).replace(f"{usual.root}/", "<rig>/")


def _topics(owner: type) -> list[str]:
    return [name for name, value in vars(owner).items() if isinstance(value, Topic)]


def _topic_meaning(name: str) -> str:
    if name in words.PRESCRIBED_TOPICS:
        return words.PRESCRIBED_TOPICS[name]
    return (inspect.getdoc(inspect.getattr_static(Topics, name)) or "").replace("\n", " ")


def history() -> str:
    """Return every table and view of the history with its columns, from a database made anew."""
    connection = sqlite3.connect(":memory:")
    migrate(connection, len(MIGRATIONS))
    found = connection.execute(
        "SELECT name, type FROM sqlite_master WHERE type IN ('table', 'view') AND name NOT LIKE 'sqlite_%'"
        " ORDER BY type, name"
    ).fetchall()
    meanings = _same(words.TABLES, [name for name, _ in found], "table or view")
    lines = ["# History", "", "Tables and views of `history.path`, SQLite. Units stand in the names. "
             "Read the views: they are what a language model may read too.", ""]  # fmt: skip
    seen: set[str] = set()
    for name, kind in sorted(found, key=lambda row: (row[1] != "view", row[0])):
        columns = connection.execute(f"SELECT name, type, pk FROM pragma_table_info('{name}')").fetchall()
        seen |= {column for column, _, _ in columns}
        rows = [
            (f"`{column}`", type_.lower(), "key" if key else "", _column_meaning(column))
            for column, type_, key in columns
        ]
        lines += [f"## {name}", "", f"{kind.capitalize()}. {meanings[name]}", ""]
        lines += table(("column", "type", "", "meaning"), rows)
    connection.close()
    if unused := words.COLUMNS.keys() - seen:
        raise KeyError(f"reference_words.COLUMNS: no table has {sorted(unused)}")
    return "\n".join(lines)


def _column_meaning(column: str) -> str:
    signals = {signal.key: f"{signal.label}, measured and good" for signal in SIGNALS.values()}
    for known in (words.COLUMNS, signals):
        if column in known:
            return known[column]
    for begin, text in words.COLUMN_BEGINNINGS.items():
        if column.startswith(begin):
            return text
    raise KeyError(f"reference_words.COLUMNS: nothing is said of {column!r}")


def variables() -> str:
    """Return every environment variable that the program or the build reads."""
    places = [
        *_python("edge"),
        *_python("firmware_protocol"),
        *_python("training"),
        ROOT / "tests/conftest.py",
    ]
    found = {name for path in places for name in variables_of(path.read_text(encoding="utf-8"))}
    meanings = _same(words.VARIABLES, found, "environment variable")
    rows = [(f"`{name}`", meanings[name]) for name in sorted(meanings)]
    return "\n".join(["# Environment variables", "", *table(("variable", "meaning"), rows)])


def variables_of(source: str) -> set[str]:
    """Return the environment variables that Python source reads or sets by name."""
    return {*VARIABLE.findall(source), *NAMED_VARIABLE.findall(source)}


def _python(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def failures() -> str:
    """Return what each failure gets, the table that the loop uses."""
    rows = [(f"`{row.key}`", row.severity.value, row.what, row.answer) for row in FAILURES.values()]
    lines = [
        "# Failures",
        "",
        "What can go wrong while the daemon runs, and the answer that it gets. The event's",
    ]
    lines += ["key is logged while the failure lasts; the key with `.over` behind it when it ends.", ""]
    return "\n".join([*lines, *table(("event", "severity", "failure", "answer"), rows)])


def signals() -> str:
    """Return every signal and actuator with unit, range and symbol."""
    measured = [
        (f"`{s.name}`", f"`{s.key}`", s.unit, f"{s.low:g} to {s.high:g}", s.literature, s.label)
        for s in SIGNALS.values()
    ]
    driven = [
        (f"`{a.name}`", f"`{a.key}`", a.unit, f"{a.low:g} to {a.high:g} by {a.step:g}", a.label)
        for a in ACTUATORS.values()
    ]
    lines = ["# Signals and actuators", "", "## Measured", ""]
    lines += table(("name", "in files", "unit", "range", "in the literature", "label"), measured)
    lines += ["## Driven", "", *table(("name", "in files", "unit", "range", "label"), driven)]
    return "\n".join(lines)


def effects() -> str:
    """Return every physical effect with its equation, parameters, source and residual."""
    lines = [
        "# Physical effects",
        "",
        "Effects that a [twin file](../my-own-data.md#the-twin-file) may name.",
        "",
    ]
    for name, effect in EFFECTS.items():
        equation = (inspect.getdoc(effect.add) or "").split("\n\n")[0].replace("\n", " ")
        lines += [f"## {name}", "", equation, "", f"- Offered: {effect.offer.value}."]
        lines += [f"- Source: {effect.source}.", f"- Residual without it: {effect.without}."]
        lines += [f"- Needs: {', '.join(f'`{column}`' for column in effect.needs)}."] if effect.needs else []
        lines += ["- Parameters:", ""]
        rows = [
            (f"`{p.name}`", p.unit, f"{p.low:g} to {p.high:g}", f"{p.start:g}") for p in effect.parameters
        ]
        lines += table(("parameter", "unit", "range", "usual"), rows)
    return "\n".join(lines)


def table(head: Sequence[str], rows: Table) -> list[str]:
    """Return a Markdown table, with a blank line behind it."""
    cells = [[str(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return [
        f"| {' | '.join(head)} |",
        f"|{'---|' * len(head)}",
        *(f"| {' | '.join(row)} |" for row in cells),
        "",
    ]


def _same(known: Mapping[str, str], found: Iterable[str], kind: str) -> Mapping[str, str]:
    """Return `known`. Raises: KeyError where it does not hold exactly the names that were found."""
    found = set(found)
    if found != known.keys():
        raise KeyError(
            f"reference_words: {kind} without words: {sorted(found - known.keys())}; "
            f"words without one: {sorted(known.keys() - found)}"
        )
    return known


PAGES: Mapping[str, Callable[[], str]] = {
    "commands.md": commands,
    "settings.md": settings,
    "topics.md": topics,
    "history.md": history,
    "environment.md": variables,
    "failures.md": failures,
    "signals.md": signals,
    "effects.md": effects,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pages."""
    parser = argparse.ArgumentParser(prog="python -m tools.reference", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder for the pages")
    folder = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
