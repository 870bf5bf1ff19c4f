"""edge/__main__.py: help, version, and numbers that no command accepts."""

import argparse
import io
import json
import re
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from loop_rig import LoopRig

from edge.__main__ import COMMANDS, GROUPS, main, parser_for
from edge.commands.orders import ORDERS, status_lines
from edge.core.version import __version__
from edge.tick.status import status_json


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as ended:
        main(words)
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out + err


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, "--version") == (0, f"greenhouse {__version__}\n")


def test_every_command_stands_once_in_the_help_and_fits_80_columns() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted([*COMMANDS, *ORDERS])
    text = parser_for(None).format_help()
    assert all(re.search(rf"^\s+{name}\b", text, re.MULTILINE) for name in (*COMMANDS, *ORDERS))
    assert all(len(line) <= 80 for line in text.splitlines())
    assert text.index("greenhouse demo") < text.index("check-config /etc") < text.index("emergency-stop")


NAMES = {"maintenance": "minutes", "reference": "DEGC", "revoke": "session"}  # of what has no option


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                yield from parsers(sub)


@pytest.mark.parametrize("command", [*COMMANDS, *ORDERS, "fleet"])
def test_no_command_reads_a_number_without_bounds(command: str) -> None:
    for parser in parsers(parser_for(command)):
        unbounded = [
            each.dest for each in parser._actions if each.type in (float, int) and each.choices is None
        ]
        assert unbounded == []


@pytest.mark.parametrize(
    "words",
    [
        "demo --speed X",
        "demo --minutes X",
        "demo --seed X",
        "demo --mqtt host:X",
        "experiment p.csv --out o.csv --minutes X",
        "experiment p.csv --out o.csv --seed X",
        "fit-arx --train a --validate b --out c --step-s X",
        "replay a.csv --reference X",
        "export --out o --first-seq X",
        "export --out o --last-seq X",
        "manual --heater-duty X",
        "manual --led X",
        "manual --fan-on X",
        "maintenance X",
        "reference X",
        "resend X 3",
        "resend 3 X",
        "twin simulate a.csv --twin t --start-rows X",
        "twin simulate a.csv --twin t --ambient-c X",
        "twin diagnose --twin t --out o --since 1d --test-share X",
        "twin benchmark --per-kind X",
        "twin benchmark --workers X",
        "what-if --heater-w X",
        "what-if --wall-factor X",
        "what-if --walls-mm X",
        "what-if --fan X",
        "what-if --reach X",
        "what-if --room X",
        "page link --days X",
        "page revoke X",
        "page revoke --link X",
        "board flash --board uno --baudrate X",
        "commission --seed X",
        "replay a.csv --horizons 60,X",
        "twin diagnose --twin t --out o --since 1d --rows X",
        "twin new f --volume 27l --fan none --heater-w X",
    ],
)
def test_a_number_that_makes_no_sense_is_refused_by_its_option(
    capsys: pytest.CaptureFixture[str], words: str
) -> None:
    place = next(i for i, word in enumerate(words.split()) if word.endswith("X"))
    option = words.split()[place - 1]
    named = option if option.startswith("--") else NAMES.get(option, "_seq")
    for value in ("-99", "nan", "inf", "1e999", "x"):
        code, text = said(capsys, *(word.replace("X", value) for word in words.split()))
        assert code == 2
        assert named in text.splitlines()[-1]


# status


@pytest.fixture
def status() -> dict[str, Any]:
    rig = LoopRig()
    rig.tick()
    found: dict[str, Any] = json.loads(json.dumps(status_json(rig.loop.status())))
    rig.close()
    return found


def test_the_status_reads_as_a_page(status: dict[str, Any]) -> None:
    lines = status_lines(status)
    assert "air        22.0 °C (good)" in lines
    assert "reference  24.0 °C, as configured" in lines
    assert "mode       auto, fan auto" in lines
    assert any(line.startswith("last tick  1 at ") for line in lines)


def test_the_status_begins_with_what_is_wrong(status: dict[str, Any]) -> None:
    operation = {**status["operation"], "emergency_stop": True, "maintenance_until_utc": 9e9}
    now = {"link_up": 0, "trips": ["overheat"], "echo": None}  # since the tick
    lines = status_lines({**status, "operation": operation, **now})
    assert [line.split()[0] for line in lines[:4]] == ["EMERGENCY", "MAINTENANCE", "TRIPPED:", "THE"]
    assert "heater     not known: the board does not say" in lines
    lines = status_lines({**status, "link_up": 0, "foreign_board": "board 2 answers, board 1 is pinned"})
    assert lines[0].startswith("ANOTHER BOARD is not driven: board 2 answers, board 1 is pinned; `greenhouse")
    assert not any("SILENT" in line for line in lines)


@pytest.mark.parametrize(
    ("cause", "ended_by"),
    [("emergency_stop", "release"), ("maintenance", "maintenance 0"), ("over_temperature", "clear-trip")],
)
def test_what_holds_the_board_is_named_with_what_ends_it(
    status: dict[str, Any], cause: str, ended_by: str
) -> None:
    held = {**status, "echo": {**status["echo"], "tripped": 1, "trip_cause": cause}}
    assert status_lines(held)[0].startswith(f"THE BOARD HAS TRIPPED: {cause}; `greenhouse {ended_by}`")


def test_a_stop_that_the_daemon_knows_of_is_named_once(status: dict[str, Any]) -> None:
    operation = {**status["operation"], "emergency_stop": True}
    echo = {**status["echo"], "tripped": 1, "trip_cause": "emergency_stop"}
    lines = status_lines({**status, "operation": operation, "echo": echo})
    assert [line for line in lines if line.isupper() or "STOP" in line or "TRIPPED" in line] == lines[:1]


def explained(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str | None]]:
    """Every command and argument of a parser and of those below it, with the text that explains it."""
    yield parser.prog, parser.description
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from explained(below)
        else:
            yield f"{parser.prog} {action.option_strings or action.dest}", action.help


@pytest.mark.parametrize("command", [*COMMANDS, *ORDERS])
def test_every_argument_of_every_command_is_explained(command: str) -> None:
    places = [
        place for place, _ in explained(parser_for(command)) if place.startswith(f"greenhouse {command}")
    ]
    texts = dict(explained(parser_for(command)))
    assert [place for place in places if not texts[place]] == []


def test_ctrl_c_while_a_command_is_still_being_imported_is_no_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("importlib.import_module", interrupted)
    assert main(["demo"]) == 130


@pytest.mark.parametrize("order", [{"emergency_stop": True}, {"maintenance_until_utc": 9e9}])
def test_while_everything_is_off_the_status_shows_no_plan(
    status: dict[str, Any], order: dict[str, Any]
) -> None:
    status["tick"]["why"] = {"rule": "below the reference"}
    assert "why        Its rule: below the reference." in status_lines(status)
    stopped = status_lines({**status, "operation": {**status["operation"], **order}})
    assert not any(line.startswith("why") for line in stopped)


def test_a_terminal_that_knows_only_ascii_gets_the_text_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.commands.why.why", lambda *_, zone: {"lines": ["24 °C"]})
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding="ascii"))
    assert main(["why", "--history", "any.db"]) == 0
    sys.stdout.flush()
    assert shown.getvalue() == b"24 ?C\n"


def test_before_the_first_tick_the_status_says_so(status: dict[str, Any]) -> None:
    assert status_lines({**status, "tick": None}) == ["no tick has been made yet"]
