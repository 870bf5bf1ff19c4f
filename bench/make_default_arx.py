"""Makes edge/models/default_arx.json: `python -m bench.make_default_arx` (`make model`), a few minutes.

The 15 predefined input sequences run on the virtual board through `greenhouse experiment`, each with the
seed of its number; every third run validates, the others train. The same seeds give the same file.
"""

import argparse
import sys
from pathlib import Path

from edge.__main__ import main as greenhouse
from edge.models.arx_file import DEFAULT_PATH
from firmware_protocol.virtual_board.profiles.record import paths

VALIDATE_EVERY = 3


def record_runs(folder: Path) -> tuple[list[Path], list[Path]]:
    """Run files for training and for validation; those that are there already are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    training: list[Path] = []
    validation: list[Path] = []
    for number, profile in enumerate(paths(), start=1):
        validates = number % VALIDATE_EVERY == 0
        out = folder / profile.name.replace("profile", "run")
        (validation if validates else training).append(out)
        if not out.exists():
            role = "validate" if validates else "train"
            _run("experiment", profile, "--out", out, "--role", role, "--virtual", "--seed", number)
    return training, validation


def _run(*words: object) -> None:
    if greenhouse([str(word) for word in words]) != 0:
        sys.exit(f"greenhouse {words[0]} failed")


def main() -> None:
    """Record, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("out/default_arx"), help="folder of the run files")
    parser.add_argument("--out", type=Path, default=DEFAULT_PATH)
    arguments = parser.parse_args()
    training, validation = record_runs(arguments.runs)
    _run("fit-arx", "--train", *training, "--validate", *validation, "--out", arguments.out)


if __name__ == "__main__":
    main()
