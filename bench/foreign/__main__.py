"""python -m bench.foreign: cases that share nothing with the engine, a solver on them, and its score.

make    cases of a split     run    the diagnosis, or a peer     score  answers against truths, as a table
"""

import sys
from collections.abc import Sequence

from bench.foreign import make, score
from edge.core.errors import GreenhouseError

COMMANDS = {"make": make.main, "run": score.run_cases, "score": score.main}


def main(words: Sequence[str] | None = None) -> int:
    """Hand on to a command. Expected errors end in one line and exit code 2."""
    name, *rest = list(sys.argv[1:] if words is None else words) or [""]
    if name not in COMMANDS:
        print(__doc__, end="")
        return 2
    try:
        return COMMANDS[name](rest)
    except GreenhouseError as error:
        print(f"python -m bench.foreign {name}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
