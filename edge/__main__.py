"""The command line. Each command lives in edge/commands/ and is imported only when it is called."""

import argparse
import importlib
import sys
from collections.abc import Sequence

from edge.commands import orders
from edge.errors import GreenhouseError

COMMANDS = {  # command -> help; the module is edge.commands.<name with underscores>
    "run": "the daemon: sense, decide, guard, actuate, record, publish",
    "demo": "the daemon against a virtual board, at accelerated time",
    "check-config": "check a configuration file",
    "experiment": "apply a profile through the same loop and record a run",
    "fit-arx": "fit an ARX model to recorded runs",
    "replay": "recorded runs through the same tick, in shadow, and how good the forecasts were",
    "export": "a stretch of the history as a run file",
    "import": "a run file into the history",
    "plot": "a picture of a stretch of history or of a run file",
    "forget-discovery": "take a rig that is no more out of Home Assistant and off the broker",
    "watch": "what the running daemon does, live",
    "ask": "say what you want in words: a language model makes a proposal, you confirm it",
    "why": "why a command was sent, from the recorded decisions",
    "twin": "the physics model: simulate it, find what it lacks, adopt what was found",
    "bundle": "signed bundles of models: verify, install, activate, roll back, list",
}


def parser_for(command: str | None) -> argparse.ArgumentParser:
    """The parser with every command's name, and the arguments of the one that was called."""
    parser = argparse.ArgumentParser(prog="greenhouse", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, help_text in COMMANDS.items():
        sub = commands.add_parser(name, help=help_text, description=help_text)
        if name == command:
            module = importlib.import_module(f"edge.commands.{_module(name)}")
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
    for name, (_, help_text, _) in orders.ORDERS.items():
        sub = commands.add_parser(name, help=help_text, description=help_text)
        orders.add_arguments(name, sub)
        sub.set_defaults(run=orders.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `greenhouse`. Expected errors end in one line and exit code 2."""
    argv = sys.argv[1:] if argv is None else list(argv)
    command = next((word for word in argv if not word.startswith("-")), None)
    arguments = parser_for(command).parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except GreenhouseError as error:
        print(f"greenhouse {arguments.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 141  # the reader of our output went away: `greenhouse status | head`


def _module(command: str) -> str:
    name = command.replace("-", "_")
    return f"{name}_history" if name == "import" else name  # `import` is no module name


if __name__ == "__main__":
    sys.exit(main())
