"""Trainings of policies as they are kept: a folder each, with weights, the rig's file and the record."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edge.core.errors import DataError

WEIGHTS_FILE, POLICY_FILE, RECORD_FILE = "weights.pt", "policy.onnx", "record.json"
FOLDERS = {  # controller -> where its trainings lie, one folder `seed_*` each
    "RL-Off": Path("rl-off/ham"),
    "RL-Off-P": Path("rl-off-p/ham"),
    "RL-On-P": Path("rl-on-p/virtual"),
    "RL-Tr-P": Path("rl-tr-p/virtual"),
}

Record = Mapping[str, Any]


def read_record(folder: Path) -> Record:
    """Read the record of a saved training. Errors: DataError"""
    path = folder / RECORD_FILE
    try:
        record: Record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    return record


def best_folder(folders: Sequence[Path]) -> Path:
    """Return the training with the highest reward in its validation episodes; the rig has no say in it.

    Errors : DataError where there is none
    """
    if not folders:
        raise DataError("no training of a policy is kept")
    return max(folders, key=lambda folder: read_record(folder)["metrics"]["validation"]["reward"])
