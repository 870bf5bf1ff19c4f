"""Shared form of the attack's parts: cases with their violations, a command line, an exit code."""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TEXTS = (
    "", " ", "\x00", "\ud800", "\udfff\ud800", "\u202e", "\x1b[2J\x1b[31m", "\r\nHTTP/1.1 200 OK", "é" * 3000,
    "A" * 200_000, "'; DROP TABLE ticks; --", "${jndi:ldap://x}", "%n%s%s", "../../../etc/passwd", "NaN",
    "ON", "PRESS", "null", "1e999", "٣", "1_0", "0x10", "-0", "1" * 400, "\ufeff24", "\n" * 5000,
)  # fmt: skip
NUMBERS = (
    float("nan"), float("inf"), -float("inf"), -0.0, 1e308, -1e308, 5e-324, 2**63, -(2**63) - 1, 10**400,
    True, False, -1, 0.5, 1.0000001, 24,
)  # fmt: skip
DEPTH = 20_000  # of nesting: beyond what Python's recursion takes


def evil_text(rng: np.random.Generator) -> str:
    """Return a string that is hard to store, print or parse."""
    if rng.random() < 0.3:
        return "".join(chr(code) for code in rng.integers(0, 0x110000, int(rng.integers(1, 60))))
    return TEXTS[int(rng.integers(len(TEXTS)))]


def evil_value(rng: np.random.Generator, depth: int = 0) -> Any:
    """Return a JSON value of any type, of the wrong type, or out of every range."""
    kind = int(rng.integers(6 if depth < 3 else 4))
    if kind == 0:
        return evil_text(rng)
    if kind == 1:
        return NUMBERS[int(rng.integers(len(NUMBERS)))]
    if kind == 2:
        return None
    if kind == 3:
        return int(rng.integers(-(2**62), 2**62))
    members = [evil_value(rng, depth + 1) for _ in range(int(rng.integers(0, 4)))]
    return members if kind == 4 else {evil_text(rng)[:100]: member for member in members}


def evil_document(rng: np.random.Generator, honest: dict[str, Any]) -> bytes:
    """`honest` as JSON with something wrong: a value, a key, its nesting, its bytes."""
    changed = dict(honest)
    kind = int(rng.integers(8))
    if kind <= 2 and changed:
        changed[str(rng.choice(sorted(changed)))] = evil_value(rng)
    elif kind == 3:
        changed[evil_text(rng)[:2000]] = evil_value(rng)
    elif kind == 4:
        return b"[" * DEPTH + b"]" * DEPTH
    elif kind == 5:
        return evil_raw(rng)
    elif kind == 6 and changed:
        del changed[str(rng.choice(sorted(changed)))]
    encoded = json.dumps(changed, ensure_ascii=bool(rng.random() < 0.7))
    data = encoded.encode(errors="surrogatepass")
    return data + data if kind == 7 else data


def evil_raw(rng: np.random.Generator) -> bytes:
    """Bytes that are not even text, or text as it comes."""
    if rng.random() < 0.5:
        return rng.bytes(int(rng.integers(0, 4000)))
    return evil_text(rng).encode(errors="surrogatepass")


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
