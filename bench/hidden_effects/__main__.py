"""python -m bench.hidden_effects: make cases with hidden effects, run the diagnosis on them, score it."""

import sys
from collections.abc import Callable, Sequence

from bench.hidden_effects import make

COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {"make": make.main}


def main(words: Sequence[str] | None = None) -> int:
    """Hand on to a command."""
    name, *rest = list(sys.argv[1:] if words is None else words) or [""]
    if name not in COMMANDS:
        print(f"python -m bench.hidden_effects {{{','.join(COMMANDS)}}} ...")
        return 2
    return COMMANDS[name](rest)


if __name__ == "__main__":
    sys.exit(main())
