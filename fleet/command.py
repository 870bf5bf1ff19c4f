"""`greenhouse fleet VERB`: many rigs. The file of a verb is imported only when it is called."""

import argparse
import importlib
import sys
from pathlib import Path
from types import ModuleType

from edge.core.errors import RequestError

HELP = "many rigs: one store, one page, bundles in waves"
VERBS = {  # verb -> module with `run_VERB(settings, arguments)`, maybe `add_VERB_arguments`, and its help
    "up": ("fleet.commands.machine", "start a fleet on this machine: authority, engines, page"),
    "down": ("fleet.commands.machine", "end it; its data stays unless it is erased"),
    "rig": ("fleet.commands.members", "add, list or remove the rigs that may come in"),
    "site": ("fleet.commands.members", "add, list or remove sites, whose own broker speaks for their rigs"),
    "user": ("fleet.commands.members", "add, list or remove people who may log in"),
    "rigs": ("fleet.commands.lists", "list the rigs that were ever heard"),
    "changes": ("fleet.commands.lists", "tell which boxes changed, and what is missing in each"),
    "rollout": ("fleet.commands.rollout", "spread a bundle in waves that are judged and rolled back"),
    "work": ("fleet.commands.work", "do the jobs of a night: diagnose the rigs whose twins disagree"),
    "ingest": ("fleet.commands.ingest", "store what rigs send, and ask for what is missing"),
    "serve": ("fleet.commands.serve", "serve the page and its API"),
    "rules": ("fleet.commands.lists", "print the rules of vmalert"),
}
OF_A_MACHINE = ("up", "down", "rig", "site")  # they make what the settings need: `run_VERB(arguments)`
SETTINGS = Path("/etc/greenhouse-fleet/fleet.yaml")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs; only the one that is called is imported."""
    called = next((word for word in sys.argv[2:] if word in VERBS), None)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, (module_name, help_text) in VERBS.items():
        verb = verbs.add_parser(name, help=help_text, description=f"{help_text[0].upper()}{help_text[1:]}.")
        if name not in OF_A_MACHINE:
            verb.add_argument("--settings", type=Path, default=SETTINGS, help=f"usual: {SETTINGS}")
        if name == called:
            module = _import(module_name)
            getattr(module, f"add_{name}_arguments", lambda parser: None)(verb)
            verb.set_defaults(run_verb=getattr(module, f"run_{name}"))


def _import(module_name: str) -> ModuleType:
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(("fleet", "edge")):
            raise
        raise RequestError(f"{error.name} is missing: pip install 'greenhouse-twin[fleet]'") from None


def run(arguments: argparse.Namespace) -> int:
    """Carry out a verb. Errors: GreenhouseError"""
    from fleet.settings import load

    try:
        if arguments.verb in OF_A_MACHINE:
            return int(arguments.run_verb(arguments))
        return int(arguments.run_verb(load(arguments.settings), arguments))
    except BrokenPipeError:
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise RequestError(f"{where}{error.strerror or error}") from error
