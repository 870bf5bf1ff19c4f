"""A case's files: what is given in one folder, the truth in another."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.hidden_effects.cases import GENERATOR_VERSION, HiddenCase
from bench.hidden_effects.draw_readings import as_given
from edge.formats.run_file import write_run
from edge.twin.twin_file import write_twin_file


def write_case(case: HiddenCase, root: Path) -> None:
    """Write all files under `root`; the truth last, so that a case with a truth is whole. Errors: OSError."""
    given, truth = folders(root, case.truth.suite, case.truth.split)
    folder = given / case.truth.id
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    truth.mkdir(parents=True, exist_ok=True)
    for name, run in case.train.items():
        write_run(run, folder / name)
    for name, run in case.test.items():
        write_run(as_given(run), folder / name)
        whole = {**run.columns, "temp_clean_c": np.array(case.truth.tests[name].clean_c)}
        write_run(replace(run, columns=whole), truth / f"{case.truth.id}_{name}")
    write_twin_file(case.twin, folder / "twin.yaml")
    if case.true_twin is not None:
        write_twin_file(case.true_twin, truth / f"{case.truth.id}_true_twin.yaml")
    text = json.dumps(case.truth.document(), indent=1)
    (truth / f"{case.truth.id}.json").write_text(text, encoding="utf-8")


def folders(root: Path, suite: str, split: str) -> tuple[Path, Path]:
    """Return the folders of cases and truths."""
    return root / suite / split / "cases", root / suite / split / "truth"


def is_made(root: Path, suite: str, split: str, name: str) -> bool:
    """Return whether the case exists, by this version of the generator."""
    given, truth = folders(root, suite, split)
    path = truth / f"{name}.json"
    return (
        path.exists()
        and (given / name).is_dir()
        and _document(path)["generator_version"] == GENERATOR_VERSION
    )


def _document(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def as_list(values: np.ndarray) -> list[float]:
    """As JSON has them [K, to 0.1 mK]."""
    return [round(float(value), 4) for value in values]


def listed_or_missing(values: np.ndarray) -> list[float | None]:
    """Return the values with None for NaN."""
    return [None if np.isnan(value) else round(float(value), 4) for value in values]
