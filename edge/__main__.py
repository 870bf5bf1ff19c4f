"""The command line. Each command lives in edge/commands/ and is imported only when it is called."""

import argparse
import importlib
import io
import sys
from collections.abc import Sequence
from typing import Any

from edge.commands import orders
from edge.core.errors import GreenhouseError
from edge.core.plain_text import storable
from edge.core.version import __version__

COMMANDS = {  # command -> help; the module is edge.commands.<name with underscores>
    "demo": "run a simulated greenhouse: no board, broker or root needed",
    "run": "run the daemon on a rig, as the systemd service does",
    "setup": "make a box of your own known: board, outputs, size, files",
    "check-config": "check a configuration file before the daemon starts with it",
    "page": "serve the web page of a rig, and say who may open it",
    "what-if": "another heater, tighter walls: reach, energy, warm-up",
    "watch": "print each tick of the running daemon",
    "why": "explain a command from the recorded decisions",
    "plot": "draw a stretch of the history, or a run file",
    "ask": "say it in words: a language model proposes, you confirm",
    "memory": "what was decided and noted: list, add, edit, forget",
    "commission": "learn a new box by step tests, and control it",
    "experiment": "apply a profile and record a run",
    "export": "write a stretch of the history to a run file",
    "import": "read run files into the history",
    "replay": "put recorded runs through the same tick; score forecasts",
    "fit-arx": "fit an ARX model to recorded runs",
    "profile": "follow a file of targets: start, pause, skip, resume, end",
    "calibrate": "correct a sensor by one or two known states",
    "data": "look at logs of another box, convert them to run files",
    "twin": "the physics model: new, simulate, find what it lacks, adopt",
    "backup": "write a rig's settings, state and history into one file",
    "restore": "put everything of a backup in its place",
    "board": "flash and configure a board, look at it, draw its wiring",
    "bundle": "install, activate or roll back signed bundles of models",
    "evidence": "seal the record day by day, prove it, report it",
    "forget-discovery": "remove a rig from Home Assistant and the broker",
}
FURTHER = "greenhouse.commands"  # entry points of further commands
MESSAGE_MAX = 1500  # characters of an error
GROUPS = {  # heading -> commands, in the order of `greenhouse --help`
    "Start here": ("demo", "setup", "check-config", "run"),
    "See what it does": ("page", "status", "watch", "why", "what-if", "plot"),
    "Tell it what to do": (
        "reference",
        "profile",
        "mode",
        "fan",
        "controller",
        "manual",
        "ask",
        "confirm",
        "discard",
        "undo",
        "memory",
    ),
    "Stop it": ("emergency-stop", "release", "maintenance", "clear-trip"),
    "Record and model your own greenhouse": (
        "commission",
        "data",
        "experiment",
        "export",
        "import",
        "replay",
        "fit-arx",
        "twin",
    ),
    "Look after a rig": (
        "calibrate",
        "board",
        "bundle",
        "backup",
        "restore",
        "evidence",
        "resend",
        "forget-discovery",
    ),
}
FIRST_STEPS = """Without a rig: `greenhouse demo`, and `greenhouse status` in another terminal.
With one: `greenhouse setup`. It writes edge.yaml; after a change by hand:
`greenhouse check-config /etc/greenhouse/edge.yaml`.
`greenhouse COMMAND --help` explains a command. Many rigs: `greenhouse fleet`."""


def parser_for(command: str | None) -> argparse.ArgumentParser:
    """Return the parser with every command's name and the arguments of the called one."""
    parser = argparse.ArgumentParser(
        prog="greenhouse",
        description="Run and observe a miniature greenhouse and its digital twin.",
        epilog=_overview(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"greenhouse {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", help="see below")
    for name, help_text in COMMANDS.items():
        sub = commands.add_parser(name, description=_sentence(help_text))
        if name == command:
            module = importlib.import_module(f"edge.commands.{_module(name)}")
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
    for name, (_, help_text, _) in orders.ORDERS.items():
        sub = commands.add_parser(name, description=_sentence(help_text))
        orders.add_arguments(name, sub)
        sub.set_defaults(run=orders.run)
    if command not in commands.choices:
        _add_further(commands, command)
    return parser


def _add_further(commands: Any, command: str | None) -> None:
    """Add a command of what is installed beside, such as `fleet`: HELP, add_arguments, run."""
    from importlib.metadata import entry_points

    for entry in entry_points(group=FURTHER):
        if entry.name == command:
            module = entry.load()
            sub = commands.add_parser(entry.name, description=_sentence(module.HELP))
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)


def _overview() -> str:
    helps = COMMANDS | {name: help_text for name, (_, help_text, _) in orders.ORDERS.items()}
    lines = [FIRST_STEPS]
    for heading, names in GROUPS.items():
        lines += ["", f"{heading}:", *(f"  {name:<18}{helps[name]}" for name in names)]
    return "\n".join(lines)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `greenhouse`. Expected errors end in one line and exit code 2."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # an ASCII terminal shows ? for the degree sign
    argv = sys.argv[1:] if argv is None else list(argv)
    command = next((word for word in argv if not word.startswith("-")), None)
    try:
        arguments = parser_for(command).parse_args(argv)
        return int(arguments.run(arguments))
    except GreenhouseError as error:
        for line in _bound(str(error)).splitlines():
            print(f"greenhouse {command}: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 141  # the reader of our output went away: `greenhouse status | head`


def _bound(text: str) -> str:
    """Return the text without control characters, at most a screen long."""
    text = storable(text)
    return text if len(text) <= MESSAGE_MAX else f"{text[:MESSAGE_MAX]}..."


def _module(command: str) -> str:
    name = command.replace("-", "_")
    return f"{name}_history" if name == "import" else name  # `import` is no module name


if __name__ == "__main__":
    sys.exit(main())
