"""The twins of the paper's case and the models over them: what is diagnosed, trained and forecast."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.models.pbm import Pbm
from edge.twin.effects.library import acting_effects
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value
from training.data.datasets import data_sha256, test_run, training_runs
from training.data.pairs import split_all
from training.evaluate.scores import TrainingScore, score_runs
from training.models.registry import HAM_GIVEN, over
from training.models.saved_training import SavedTraining, remove_guard
from training.models.study import SCENARIOS, Regime, TrainingJob, validity
from training.models.twin_step import beyond_a_graph

ROOT = Path(__file__).parents[2]
BARE_FILE, TWIN_FILE, DIAGNOSIS_FILE = "bare.yaml", "twin.yaml", "diagnosis.json"
TWIN, TWIN_HELD = "pbm_improved", "pbm_improved_held"
HAM, HAM_GUARDED = "ham_improved", "ham_improved_guarded"


@dataclass(frozen=True, slots=True, eq=False)
class ImprovedTwin:
    """A twin that a diagnosis has handed on.

    runs : how many it was made on
    held : of it what a hybrid's graph holds, its values fitted again where something was left out
    left_out : the effects that it does not hold
    document : diagnosis.json
    """

    regime: Regime
    runs: int
    file: TwinFile
    held: TwinFile
    left_out: tuple[str, ...]
    document: Mapping[str, Any]


def diagnose(regime: Regime, folder: Path) -> None:
    """`greenhouse twin diagnose` on the regime's runs, from the balance with no effect; files to `folder`.

    Errors : DataError where the command fails; it has said why
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / TWIN_FILE).unlink(missing_ok=True)  # none is written where nothing is named
    write_twin_file(TwinFile(), folder / BARE_FILE)
    judged = [test_run(number) for number in SCENARIOS[regime]]
    words = ["twin", "diagnose", *_paths(training_runs(regime)), "--test", *_paths(judged)]
    words += ["--twin", _name(folder / BARE_FILE), "--out", _name(folder), "--json-only"]
    code = subprocess.run([sys.executable, "-m", "edge", *words], cwd=ROOT, check=False).returncode
    if code != 0:
        raise DataError(f"{folder}: greenhouse twin diagnose failed, exit code {code}")


def improved_twin(regime: Regime, folder: Path) -> ImprovedTwin:
    """Return the result of `diagnose`. Errors: DataError for no diagnosis, or one of other runs"""
    path = folder / DIAGNOSIS_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    runs = training_runs(regime)
    if document["data_sha256"] != data_sha256(runs):
        raise DataError(f"{path}: data_sha256: of other runs than those recorded here")
    file = read_twin_file(folder / TWIN_FILE) if document["effects"] else TwinFile()
    return _improve(regime, file, document, runs)


def forecasts(
    twin: ImprovedTwin, seeds: Sequence[int], out: Path, scenarios: Sequence[int] | None = None
) -> list[TrainingScore]:
    """Forecast with the twin and the hybrids over it on the regime's scenarios, or on those in `scenarios`.

    out : where the networks are left
    """
    return [one.score for one in score_runs(_trainings(twin, seeds, out), scenarios)]


def _improve(
    regime: Regime, file: TwinFile, document: Mapping[str, Any], runs: Sequence[RecordedRun]
) -> ImprovedTwin:
    left_out = tuple(name for name in acting_effects(file.effects) if name in beyond_a_graph(file.twin()))
    if not left_out:
        return ImprovedTwin(regime, len(runs), file, file, (), document)
    effects = {
        name: {key: Value(value.value, fit=True) for key, value in own.items()}
        for name, own in file.effects.items()
        if name not in left_out
    }
    held = fit_twin(replace(file, effects=effects), split_all(runs).train).file
    return ImprovedTwin(regime, len(runs), file, held, left_out, document)


def _trainings(twin: ImprovedTwin, seeds: Sequence[int], out: Path) -> Iterator[SavedTraining]:
    runs = training_runs(twin.regime)
    record = {"data_sha256": data_sha256(runs), "validity": validity(runs)}
    yield SavedTraining(TWIN, twin.regime, 0, Pbm(twin.file.twin()), record, out)
    if twin.left_out:
        yield SavedTraining(TWIN_HELD, twin.regime, 0, Pbm(twin.held.twin()), record, out)
    train = over(twin.held)[HAM_GIVEN]
    for seed in seeds:
        trained = train(runs, seed, None)
        folder = TrainingJob(HAM, twin.regime, seed, "").folder(out)
        folder.mkdir(parents=True, exist_ok=True)
        trained.save(folder, {"seed": seed, **record})
        kept = SavedTraining(HAM_GUARDED, twin.regime, seed, trained.predictor, record, folder)
        yield replace(remove_guard(kept), model=HAM)
        yield kept


def _paths(runs: Sequence[RecordedRun]) -> list[str]:
    return [_name(run.path) for run in runs if run.path is not None]


def _name(path: Path) -> str:
    """As it is called from the project's folder: the command stands in the files that it writes."""
    return os.path.relpath(path.resolve(), ROOT)
