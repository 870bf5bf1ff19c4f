"""How often the diagnosis is right where the truth is known: cases with hidden effects, made, run and scored.

The cases are boxes that share nothing with the diagnosis: other physics, disturbances, sizes and pace. The
kinds `greenhouse` and `greenhouse_null` are of the virtual board's greenhouse.

Needs the project's checkout, which holds the cases' generator and the scorer.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from edge.commands.arguments import whole
from edge.core.errors import RequestError

CHECKOUT = Path(__file__).resolve().parents[2]
BENCH = "bench.foreign"
QUICK_CASES = 2  # of each kind


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--split", choices=("dev", "scored"), default="scored", help="cases used while tuning, or only scored"
    )
    parser.add_argument("--kinds", help="of case, comma between; default: all")
    parser.add_argument("--per-kind", type=whole(1), metavar="N", help="cases of each kind; default: all")
    parser.add_argument(
        "--seed-from", type=whole(0), default=0, metavar="N", help="first number within a kind; default: 0"
    )
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_CASES} cases of each kind")
    parser.add_argument("--workers", type=whole(1), default=2, help="cases at a time; default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("out/twin_benchmark"), help="cases and answers")


def run(arguments: argparse.Namespace) -> int:
    """Make what cases are missing, run and score them; the tables on standard output.

    Returns : the exit code of the step that failed, 0 when none did
    Errors : RequestError where there is no checkout
    """
    refuse_without_checkout(CHECKOUT)
    for step in steps(arguments):
        code = subprocess.run([sys.executable, "-m", BENCH, *step], cwd=CHECKOUT, check=False).returncode
        if code:
            return code
    return 0


def refuse_without_checkout(checkout: Path) -> None:
    """Say what is missing before anything is made. Errors: RequestError"""
    folder = checkout / BENCH.replace(".", "/")
    if not (folder / "__main__.py").exists():
        raise RequestError(f"{folder}: is not there: the benchmark runs in a checkout of the project")


def steps(arguments: argparse.Namespace) -> list[list[str]]:
    """Arguments of make, run and score, in this order."""
    which = ["--split", arguments.split, "--out", str(arguments.out.absolute()), *_few(arguments)]
    which += ["--kinds", arguments.kinds] if arguments.kinds else []
    which += ["--seed-from", str(arguments.seed_from), "--workers", str(arguments.workers)]
    return [[step, *which] for step in ("make", "run", "score")]


def _few(arguments: argparse.Namespace) -> list[str]:
    per_kind = QUICK_CASES if arguments.quick else arguments.per_kind
    return [] if per_kind is None else ["--per-kind", str(per_kind)]
