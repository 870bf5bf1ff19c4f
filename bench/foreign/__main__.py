"""python -m bench.foreign: cases that share nothing with the engine, the diagnosis on them, and its score.

make    cases of a split     run    the diagnosis on them     score  answers against truths, as a table
"""

import sys
from collections.abc import Sequence

from bench.foreign import make, score

COMMANDS = {"make": make.main, "run": score.run_cases, "score": score.main}


def main(words: Sequence[str] | None = None) -> int:
    """Hand on to a command."""
    name, *rest = list(sys.argv[1:] if words is None else words) or [""]
    if name not in COMMANDS:
        print(__doc__, end="")
        return 2
    return COMMANDS[name](rest)


if __name__ == "__main__":
    sys.exit(main())
