"""python -m bench.foreign: cases that share nothing with the engine, the diagnosis on them, and its score.

make    cases of a split     run    the diagnosis on them     score  answers against truths, as a table
"""

import importlib
import sys
from collections.abc import Sequence

COMMANDS = ("make", "run", "score")


def main(words: Sequence[str] | None = None) -> int:
    """Hand on to a command."""
    name, *rest = list(sys.argv[1:] if words is None else words) or [""]
    if name not in COMMANDS:
        print(__doc__, end="")
        return 2
    return int(importlib.import_module(f"bench.foreign.{name}").main(rest))


if __name__ == "__main__":
    sys.exit(main())
