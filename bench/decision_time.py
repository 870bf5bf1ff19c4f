"""python -m bench.decision_time: what a decision of every controller takes, beside the paper's MPC.

Each runs through the whole daemon along the reference kept for tuning, one after the other; wall clock, so
nothing else should run. A language model's time is the daemon's own work on its answers, without the network:
a scripted stand-in answers at once.
"""

import argparse

from edge.config.settings import LlmSettings
from edge.formats.table import Table
from training.control.comparison import STAND_IN_MODEL
from training.control.figures import decision_time
from training.control.job import ComparisonJob, run
from training.control.rig import SPARING, entries
from training.llm_stand_in.server import StandIn

PEER = "MPC-BFGS"
REFERENCE, SEED = "tuning_1", 101
HEADS = ("controller", "median [ms]", "p99 [ms]", f"median by {PEER}'s")


def main() -> None:
    """Print the table."""
    known = [name for name in entries() if name not in SPARING and not name.startswith("clairvoyant")]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--controllers", nargs="+", choices=known, default=known, metavar="NAME")
    names = parser.parse_args().controllers
    with StandIn() as stand_in:
        llm = LlmSettings(url=stand_in.url, model=STAND_IN_MODEL)
        found = {
            name: decision_time(run(ComparisonJob(entries()[name], REFERENCE, SEED, llm)))
            for name in dict.fromkeys((PEER, *names))
        }
    peer_ms = found[PEER].median_ms
    rows = tuple(
        (name, f"{one.median_ms:.2f}", f"{one.p99_ms:.1f}", f"{one.median_ms / peer_ms:.3g}")
        for name, one in found.items()
    )
    print("\n".join(Table("Decision time", HEADS, rows, f"{REFERENCE}, board {SEED}.").text()))


if __name__ == "__main__":
    main()
