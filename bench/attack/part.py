"""Shared form of the attack's parts: cases with their violations, a command line, an exit code."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrialResult:
    """One trial: its name with its seed, how many cases it stands for, and what was wrong, in words."""

    name: str
    cases: int
    violations: Sequence[str]


Part = Callable[[int, int], Iterator[TrialResult]]


def report(part: Part, seed: int, count: int, what: str) -> int:
    """Print every violation and one line at the end; the number of violations."""
    cases = bad = 0
    for found in part(seed, count):
        cases += found.cases
        bad += len(found.violations)
        for text in found.violations:
            print(f"  {what}, {found.name}: {text}", flush=True)
    print(f"{what:<12} {cases:>6} cases from seed {seed:<6} {bad:>4} violations", flush=True)
    return bad


def main_of(part: Part, seed: int, count: int, what: str, about: str | None) -> int:
    """Run one part by its command line; 1 when an invariant was violated."""
    parser = argparse.ArgumentParser(prog=f"python -m bench.attack.{what}", description=about)
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--count", type=int, default=count)
    arguments = parser.parse_args()
    return 1 if report(part, arguments.seed, arguments.count, what) else 0
