"""python -m bench unchanged [--against CHECKOUT]: digests of results that a rearrangement must not change.

Every result comes from a public command, so the same file measures an older commit:
`git worktree add /tmp/old COMMIT; python -m bench unchanged --against /tmp/old` runs both on one machine.
Durations, versions and dates are left out; every other digit counts.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent
VOLATILE = {"seconds", "software", "command", "solve_ms"}  # durations, versions and temporary paths
COMPARED = ("MPC-Twin-P", "MPC-BFGS")  # one mixed-integer plan on the twin, one continuous


@dataclass(frozen=True, slots=True)
class Place:
    """A checkout whose packages run, a folder for its output, and the measured logs."""

    checkout: Path
    out: Path
    logs: Path


def run(place: Place, *words: str | Path) -> str:
    """Return what `python -m WORDS` prints in the checkout. Errors: RuntimeError with its messages"""
    command = [sys.executable, "-m", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(place.checkout)}
    done = subprocess.run(
        command, cwd=place.checkout, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[2:])}: {done.stdout}{done.stderr}")
    return done.stdout


def example_diagnosis(place: Place) -> str:
    """Digest the answer about the example's runs."""
    example = place.checkout / "docs/examples/diagnosis"
    report = place.out / "report"
    runs = sorted(example.glob("train_*.csv"))
    test, twin = example / "test_1.csv", example / "twin.yaml"
    run(place, "edge", "twin", "diagnose", *runs, "--test", test, "--twin", twin, "--out", report)
    return _document(report / "diagnosis.json")


def compared_runs(place: Place) -> str:
    """Digest every column of closed-loop runs on the first reference, after a check against saved figures."""
    runs = place.out / "runs"
    words = ("--references", "reference_1", "--seeds", "1", "--runs", runs, "--workers", "2", "--check")
    run(place, "training", "compare", "--controllers", *COMPARED, *words)
    digest = hashlib.sha256()
    for path in sorted(runs.rglob("columns.npz")):
        with np.load(path) as columns:
            for name in sorted(set(columns.files) - VOLATILE):
                digest.update(f"{path.parent.relative_to(runs)} {name}".encode() + columns[name].tobytes())
    return digest.hexdigest()


def replays(place: Place) -> str:
    """Digest the decisions and forecast errors over the recorded runs of this repository."""
    runs = sorted((place.checkout / "training/data/runs").glob("scenario_*.csv"))
    return _text(run(place, "edge", "replay", "--controller", "MPC", *runs))


def measured_replays(place: Place) -> str:
    """Digest the decisions and forecast errors over the measured logs."""
    runs = sorted((place.logs / "heated_box").glob("*.csv"))
    words = ("--no-fan", "--no-ambient", "--fan-always-on", "--horizons", "60,300")
    return _text(run(place, "edge", "replay", "--controller", "MPC", *runs, *words))


def measured_diagnosis(place: Place) -> str:
    """Digest the answer about one measured log."""
    words = ("--data", place.logs, "--only", "energy balance", "--out", place.out)
    run(place, "bench.real_truth", *words)
    (answer,) = (place.out / "answers").rglob("diagnosis.json")
    return _document(answer)


def golden_vectors(place: Place) -> str:
    """Digest the protocol's vectors, the generated C messages and the packaged models."""
    digest = hashlib.sha256()
    found = [
        *(
            "firmware_protocol/vectors.json",
            "firmware_protocol/c/gh_messages.h",
        ),
        *sorted(
            str(path.relative_to(place.checkout))
            for path in (place.checkout / "edge/models/default_bundle").iterdir()
        ),
    ]
    for name in found:
        digest.update(name.encode() + (place.checkout / name).read_bytes())
    return digest.hexdigest()


RESULTS: Mapping[str, Callable[[Place], str]] = {
    "example diagnosis": example_diagnosis,
    "compared runs": compared_runs,
    "replays": replays,
    "measured logs, replayed": measured_replays,
    "measured log, diagnosed": measured_diagnosis,
    "golden vectors": golden_vectors,
}


def _document(path: Path) -> str:
    return _text(json.dumps(_without_volatile(json.loads(path.read_text(encoding="utf-8"))), sort_keys=True))


def _without_volatile(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_volatile(item) for key, item in value.items() if key not in VOLATILE}
    return [_without_volatile(item) for item in value] if isinstance(value, list) else value


def _text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def digests(checkout: Path, logs: Path, names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield each result's name and digest."""
    for name in names:
        with tempfile.TemporaryDirectory(prefix="greenhouse-unchanged-") as out:
            yield name, RESULTS[name](Place(checkout.resolve(), Path(out), logs.resolve()))


def main() -> int:
    """Print the digests; return 1 if the other checkout gives different ones."""
    parser = argparse.ArgumentParser(prog="python -m bench unchanged", description=__doc__)
    parser.add_argument("--against", type=Path, help="another checkout that must give the same")
    parser.add_argument("--logs", type=Path, default=ROOT / "../shared/data", help="folder of measured logs")
    parser.add_argument("--only", nargs="+", default=list(RESULTS), choices=RESULTS, metavar="NAME")
    arguments = parser.parse_args()
    changed = []
    for name, here in digests(ROOT, arguments.logs, arguments.only):
        line = f"{name:24s} {here[:16]}"
        if arguments.against is not None:
            there = dict(digests(arguments.against, arguments.logs, [name]))[name]
            line += f"  there {there[:16]}  {'same' if here == there else 'CHANGED'}"
            changed += [name] if here != there else []
        print(line, flush=True)
    return int(bool(changed))


if __name__ == "__main__":
    sys.exit(main())
