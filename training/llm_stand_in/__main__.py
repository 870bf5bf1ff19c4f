"""`python -m training.llm_stand_in --port 0 --behave honest`: serve until Ctrl-C, print the base URL."""

import argparse
import time
from contextlib import suppress

from training.llm_stand_in.behaviours import BEHAVIOURS
from training.llm_stand_in.server import StandIn


def main() -> None:
    """Serve until Ctrl-C; print the base URL first, which tells the caller the port that `--port 0` got."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8000, help="0: a free one")
    parser.add_argument("--behave", choices=sorted(BEHAVIOURS), default="honest")
    parser.add_argument("--seed", type=int, default=0, help="of the jitter at temperature 1")
    arguments = parser.parse_args()
    with StandIn(arguments.behave, arguments.seed, arguments.port) as stand_in, suppress(KeyboardInterrupt):
        print(f"{stand_in.url}  ({arguments.behave})", flush=True)
        while True:
            time.sleep(3600.0)


if __name__ == "__main__":
    main()
