"""Random fault scenarios of the whole daemon: python -m bench.attack.scenarios --seed S --count N."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.attack.invariants import violations
from bench.attack.lives import run as live
from bench.attack.part import TrialResult, main_of
from bench.attack.plan import draw
from training.sweep import sweep

WORKERS = os.cpu_count() or 1


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """Each scenario with its violations, in the order of the seeds."""
    yield from sweep(one, range(seed, seed + count), WORKERS)


def one(seed: int) -> TrialResult:
    """One scenario."""
    with tempfile.TemporaryDirectory(prefix="gh-attack-") as name:
        try:
            found = violations(live(draw(seed), Path(name)))
        except Exception as error:
            found = [f"the scenario itself failed: {error!r}"]
    return TrialResult(f"seed {seed}", 1, found)


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 1000, "scenarios", __doc__))
