"""`greenhouse twin ACTION`: the physics model and its measurements."""

import argparse
import importlib
import importlib.util

ACTIONS = {  # action -> help; the module is edge.commands.twin_<action>
    "new": "write a twin file for a box, with what is not known to be fitted",
    "diagnose": "find where twin and measurements disagree, name the missing effect, add it",
    "simulate": "run a twin freely over recorded runs and print its errors",
    "benchmark": "measure how often the diagnosis is right where the truth is known",
    "adopt": "make the twin of a diagnosis the running one, or take that back",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: those of each action, whose parser says which module runs it."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, help_text in ACTIONS.items():
        place = f"edge.commands.twin_{name}"
        if importlib.util.find_spec(place) is None:
            continue
        module = importlib.import_module(place)
        sub = actions.add_parser(name, help=help_text, description=module.__doc__)
        module.add_arguments(sub)
        sub.set_defaults(run_action=module.run)


def run(arguments: argparse.Namespace) -> int:
    """Run the action's module and return its exit code."""
    return int(arguments.run_action(arguments))
