"""`greenhouse check-config FILE`: is this configuration fit to run?"""

import argparse
import sys

from edge.app.config_check import problems
from edge.config import loading as config
from edge.core.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", help="configuration file, as /etc/greenhouse/edge.yaml")


def run(arguments: argparse.Namespace) -> int:
    """0 when the daemon would start with it and every part would work. Errors: ConfigError with all problems.

    What may be right later or for another user is a warning on standard error.
    """
    settings = config.load(arguments.file)
    found = list(problems(settings))
    for problem in found:
        if not problem.is_error:
            print(f"warning: {arguments.file}: {problem.text}", file=sys.stderr)
    if errors := [problem.text for problem in found if problem.is_error]:
        raise ConfigError("\n".join(f"{arguments.file}: {text}" for text in errors))
    print(f"{arguments.file} is good (settings {config.config_hash(settings)})")
    return 0
