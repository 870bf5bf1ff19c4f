"""python -m bench: every table of the manual, one bench after the other; each table names its command.

Tables are printed and kept in bench/results/. With --quick they are short, prove only that the benches run,
and go to out/bench/. `python -m bench NAME OPTION ...` gives one bench its own options and keeps nothing.
"""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.header import MEASURED, header, report

RESULTS = Path("bench/results")
QUICK_RESULTS = Path("out/bench")


@dataclass(frozen=True, slots=True)
class Bench:
    """A module of this package, and how it is called."""

    quick: tuple[str, ...]  # arguments of a short run
    keeps_its_table: bool = False  # and pictures beside it: it is told where instead


BENCHES = {
    "daemon": Bench(("--seconds", "15", "--starts", "2", "--hours", "1")),
    "kills": Bench(("--kills", "5")),
    "outbox": Bench(("--ticks", "1000", "--kills", "2")),
    "example_diagnosis": Bench(
        ("--out", "out/bench/example_diagnosis.txt", "--images", "out/bench"), keeps_its_table=True
    ),
    "attack": Bench(("--share", "0.01")),
    "drift_alarms": Bench(("--paths", "5", "--days", "6", "--boxes", "1")),
    "real_truth": Bench(("--only", "energy balance")),
    "board_fuzz": Bench(("--bytes", "3e6")),
    "fleet_rollout": Bench(("--seeds", "1")),
    "boxes": Bench(("--boxes", "9", "--rows", "PID", "MPC-Twin-P")),
    "incubator": Bench(("--rows", "PID", "--minutes", "120")),
    "unchanged": Bench(("--only", "golden vectors"), keeps_its_table=True),
}  # fmt: skip


def run(name: str, is_quick: bool) -> int:
    """Print one bench's table as it comes, keep it; the exit code."""
    bench, results = BENCHES[name], QUICK_RESULTS if is_quick else RESULTS
    results.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", f"bench.{name}", *(bench.quick if is_quick else ())]
    print(f"\n### {name}", flush=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [f"{line}\n" for line in header()] if name in MEASURED else []
        print("".join(lines), end="", flush=True)
        for line in process.stdout:
            print(line, end="", flush=True)
            lines.append(line)
    if process.returncode == 0 and not bench.keeps_its_table:
        (results / f"{name}.txt").write_text("".join(lines))
    return process.returncode


def main(words: Sequence[str] | None = None) -> int:
    """Run the benches that are named, or all; 1 when one of them failed, after the others have run."""
    words = sys.argv[1:] if words is None else words
    if words and words[0] in BENCHES and set(words[1:]) - {*BENCHES, "--quick"}:
        return subprocess.run([sys.executable, "-m", f"bench.{words[0]}", *words[1:]], check=False).returncode
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHES)}; none: all")
    parser.add_argument("--quick", action="store_true", help="some minutes instead of an hour or more")
    parser.add_argument(
        "--stale", action="store_true", help="which timing tables are older than the code that they measured"
    )
    arguments = parser.parse_args(words)
    if arguments.stale:
        print("\n".join(report()))
        return 0
    if unknown := [name for name in arguments.names if name not in BENCHES]:
        parser.error(f"there is no {unknown[0]!r}; there are {', '.join(BENCHES)}")
    failed = [name for name in arguments.names or BENCHES if run(name, arguments.quick) != 0]
    if failed:
        print(f"\nfailed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
