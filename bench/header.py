"""Header of a timing table: where it was measured, and whether the measured code has changed since.

`python -m bench NAME` begins a timing table with `header`. `python -m bench --stale` compares the commit of
each kept table with the newest commits of the paths that its bench measures.
"""

import math
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "bench" / "results"
MEASURED: Mapping[str, tuple[str, ...]] = {  # bench -> the code that its figures are of
    "attack": ("edge", "firmware_protocol", "bench/attack", "bench/kills.py"),
    "kills": ("edge", "firmware_protocol", "bench/kills.py"),
    "daemon": ("edge", "firmware_protocol", "bench/daemon.py", "bench/default_daemon.py"),
    "outbox": ("edge/mqtt", "edge/storage", "edge/formats/tick_json.py", "bench/outbox.py"),
    "real_truth": ("edge/twin", "edge/diagnosis", "bench/real_truth"),
}
_COMMIT = re.compile(r"^commit ([0-9a-f]{7,40})", re.MULTILINE)


def header() -> Iterator[str]:
    """Lines that begin a table: commit, machine and load average."""
    changed = " with uncommitted changes" if _git("status", "--porcelain", "--untracked-files=no") else ""
    yield f"commit {_git('rev-parse', '--short=12', 'HEAD') or 'unknown'}{changed}"
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    yield f"{processor()}, {platform.machine()}, {os.cpu_count()} cores; load average {load} at the start"


def processor() -> str:
    """Return the processor's name as the kernel has it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "processor unknown")


def staleness(name: str, table: str) -> str:
    """Say whether the code that a table measured has changed since its commit.

    name : of the bench, a key of MEASURED; table : the text of its table
    """
    found = _COMMIT.search(table)
    if found is None:
        return "names no commit: measure anew"
    if not _git("rev-parse", "--verify", f"{found[1]}^{{commit}}"):
        return f"commit {found[1]} is not in this repository"
    later = _git("log", "--format=%h", f"{found[1]}..HEAD", "--", *MEASURED[name]).split()
    if not later:
        return f"current, commit {found[1]}"
    return f"the code measured has changed since {found[1]}, in {len(later)} commits, {later[0]} the newest"


def report() -> Iterator[str]:
    """One line for each committed timing table."""
    for name in MEASURED:
        path = RESULTS / f"{name}.txt"
        text = staleness(name, path.read_text(encoding="utf-8")) if path.exists() else "not measured"
        yield f"{name:14} {text}"


def _git(*words: str) -> str:
    """Return git's answer, "" where it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


_95 = 1.959964  # standard deviations of a normal distribution, both sides


@dataclass(frozen=True, slots=True)
class Share:
    """`hits` of `cases`; a share of no cases is NaN, and its interval says nothing: 0 to 1."""

    hits: int
    cases: int

    @property
    def value(self) -> float:
        """0..1."""
        return self.hits / self.cases if self.cases else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % (Wilson 1927, Journal of the American Statistical Association 22)."""
        if not self.cases:
            return 0.0, 1.0
        share, square = self.hits / self.cases, _95**2 / self.cases
        middle = (share + square / 2.0) / (1.0 + square)
        half = math.sqrt(share * (1.0 - share) * square + square**2 / 4.0) / (1.0 + square)
        return max(0.0, middle - half), min(1.0, middle + half)


def share(answers: Iterable[bool]) -> Share:
    """Return the share that is true."""
    given = list(answers)
    return Share(sum(given), len(given))
