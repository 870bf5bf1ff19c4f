"""python -m bench.hidden_effects: make cases with hidden effects, run the diagnosis on them, score it.

make    cases of a suite and split             run    the diagnosis and the peers on them
score   answers against truths, as tables      table  the tables again
"""

import importlib
import sys
from collections.abc import Sequence

from edge.core.errors import GreenhouseError

COMMANDS = {"make": "make", "run": "run_cases", "score": "score_files", "table": "table"}  # and their modules


def main(words: Sequence[str] | None = None) -> int:
    """Hand on to a command. Expected errors end in one line and exit code 2."""
    name, *rest = list(sys.argv[1:] if words is None else words) or [""]
    if name not in COMMANDS:
        print(__doc__, end="")
        return 2
    try:
        return int(importlib.import_module(f"bench.hidden_effects.{COMMANDS[name]}").main(rest))
    except GreenhouseError as error:
        print(f"python -m bench.hidden_effects {name}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
