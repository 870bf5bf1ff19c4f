"""Records the training and test runs: `python -m training.data.record`, about five minutes.

Each run goes through `greenhouse experiment` on a virtual board: the daemon's loop, its safety, the serial
protocol and the simulated box. The same profile and board seed give the same file, bit for bit; `--check`
records again and tells which files differ.
"""

import argparse
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from edge.__main__ import main as greenhouse
from edge.core.errors import GreenhouseError
from edge.formats.run_file import RecordedRun, read_run, write_run
from firmware_protocol.virtual_board.profiles.record import paths
from training.data.datasets import REGIMES, RUNS, TRAIN_SHARE, regimes_of
from training.data.draw_profiles import PLANS, path_of


@dataclass(frozen=True, slots=True)
class TrainingRecording:
    """One run: what is applied to which box, and what it is for."""

    name: str
    profile: Path
    seed: int  # of the virtual board
    role: str
    facts: Mapping[str, str]


def recordings() -> list[TrainingRecording]:
    """Return the 15 training runs, sequence n on board n, and the 6 scenarios."""
    training = [
        TrainingRecording(path.stem.replace("profile", "run"), path, number, "train", {})
        for number, path in enumerate(paths(), start=1)
    ]
    return training + [
        _scenario(half * len(PLANS) + number, number, half)
        for half in range(len(REGIMES))
        for number in range(1, len(PLANS) + 1)
    ]


def _scenario(scenario: int, number: int, half: int) -> TrainingRecording:
    facts = {"scenario": str(scenario), "regime": REGIMES[half]}
    seed = PLANS[number - 1].board_seeds[half]
    return TrainingRecording(f"scenario_{scenario}", path_of(number), seed, "test", facts)


def record(recording: TrainingRecording, path: Path, minutes: float | None = None) -> RecordedRun:
    """Record a run into the file `path`: its whole profile or the first minutes. Errors: GreenhouseError."""
    with tempfile.TemporaryDirectory(prefix="greenhouse-record-") as folder:
        raw = Path(folder) / path.name
        words = ["experiment", recording.profile, "--out", raw, "--role", recording.role]
        words += ["--virtual", "--seed", recording.seed]
        words += [] if minutes is None else ["--minutes", minutes]
        if greenhouse([str(word) for word in words]) != 0:
            raise GreenhouseError(f"{path}: greenhouse experiment failed")
        run = read_run(raw)
    # A new version of the software that changes no number changes no file.
    facts = {key: value for key, value in run.facts.items() if key != "software"}
    run = replace(run, facts=facts | _use(recording, run), path=path)
    write_run(run, path)
    return run


def _use(recording: TrainingRecording, run: RecordedRun) -> dict[str, str]:
    """Facts on what the run is for."""
    if recording.role == "test":
        return dict(recording.facts)
    validate_from_s = run.columns["time_s"][int(TRAIN_SHARE * len(run))]
    return {"regime": ", ".join(regimes_of(run)), "validate_from_s": f"{validate_from_s:g}"}


def main() -> int:
    """0; with --check 1 where a file differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing, compare with the files kept")
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these, e.g. run_01 scenario_3")
    arguments = parser.parse_args()
    chosen = [one for one in recordings() if not arguments.names or one.name in arguments.names]
    unknown = set(arguments.names) - {one.name for one in chosen}
    if unknown:
        parser.error(f"there is no run {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory(prefix="greenhouse-record-") as folder:
        differing = [one.name for one in chosen if not _is_saved(one, Path(folder), arguments.check)]
    print(f"{len(differing)} of {len(chosen)} runs differ{': ' if differing else ''}{', '.join(differing)}")
    return 1 if arguments.check and differing else 0


def _is_saved(recording: TrainingRecording, folder: Path, check: bool) -> bool:
    """Return whether the saved file is what was recorded now; without `check` it is saved now."""
    new, kept = folder / f"{recording.name}.csv", RUNS / f"{recording.name}.csv"
    record(recording, new)
    same = kept.exists() and kept.read_bytes() == new.read_bytes()
    if not same and not check:
        RUNS.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(new.read_bytes())
    return same


if __name__ == "__main__":
    sys.exit(main())
