"""Every model that can be trained, by the name it has in tables; the paper's four, then ours beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import nn

from edge.core.errors import DataError
from edge.core.predictor import Predictor
from edge.formats.run_file import RecordedRun, data_sha256
from edge.models.arx import FanInput
from edge.models.arx_file import write_arx
from edge.models.fit_arx import FREE_RUN_STEPS, ArxFit, fit_arx
from edge.models.pbm import Pbm
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile, write_twin_file
from training.data.pairs import split_all
from training.models import ham, pbm
from training.models.fit_network import Progress
from training.models.predictors import GuardedHamPredictor, HamPredictor, WindowPredictor
from training.models.rollout import START_ROWS
from training.models.study import Train, TrainedModel
from training.models.weights import save_network
from training.models.window_network import LstmNet, WindowNet, WindowSettings, train

NETWORK_FILE, TWIN_FILE, ARX_FILE = "network.pt", "twin.yaml", "arx.json"
ORDERS = tuple((p, q) for p in (1, 2, 3, 4, 6, 8, START_ROWS) for q in (1, 2, 3, 4, 6))


@dataclass(frozen=True, slots=True)
class LinearSettings:
    """The paper's form (eq. method-arx-equation); with ambient and excess it is the rig's own, see `Arx`."""

    step_s: float = 60.0
    orders: tuple[tuple[int, int], ...] = ORDERS
    fan_input: FanInput = "on"
    with_ambient: bool = False


WITH_AMBIENT = LinearSettings(fan_input="excess", with_ambient=True)


def _linear(
    settings: LinearSettings, runs: Sequence[RecordedRun], seed: int, log: Path | None
) -> TrainedModel:
    parts = split_all(runs)
    fit = fit_arx(parts.train, parts.validate, **asdict(settings))
    progress = {
        "p": len(fit.model.temp),
        "q": len(fit.model.heater),
        "rows": fit.rows,
        "validation_free_run_rmse_k": fit.free_run_rmse_k,
    }
    return TrainedModel(fit.model, asdict(settings), progress, partial(_save_linear, fit))


def _save_linear(fit: ArxFit, out: Path, facts: Mapping[str, Any]) -> None:
    scores = {
        "rows": fit.rows,
        "one_step_rmse_k": fit.one_step_rmse_k,
        "free_run_rmse_k": fit.free_run_rmse_k,
        "free_run_steps": FREE_RUN_STEPS,
        "orders_tried": [[score.p, score.q, score.rmse_k] for score in fit.scores],
    }
    write_arx(fit.model, out / ARX_FILE, {**facts, **scores})


def _pbm(settings: pbm.PbmSettings, runs: Sequence[RecordedRun], seed: int, log: Path | None) -> TrainedModel:
    file = pbm.train(runs, settings)
    return TrainedModel(Pbm(file.twin()), asdict(settings), {}, partial(_save_twin, file))


def _save_twin(file: TwinFile, out: Path, facts: Mapping[str, Any]) -> None:
    write_twin_file(replace(file, provenance=dict(facts)), out / TWIN_FILE)


def train_window(
    network_type: type[WindowNet],
    settings: WindowSettings,
    runs: Sequence[RecordedRun],
    seed: int,
    log: Path | None,
) -> TrainedModel:
    """Train a network of a window, as `Train` wants it when the first two arguments are bound."""
    network, progress = train(network_type, runs, seed, settings, log)
    return _trained_model(WindowPredictor(network), network, settings, progress)


def _ham(settings: ham.HamSettings, runs: Sequence[RecordedRun], seed: int, log: Path | None) -> TrainedModel:
    network, progress = ham.train(runs, seed, settings, log)
    return _trained_model(HamPredictor(network), network, settings, progress)


def _train_guarded(
    settings: ham.GuardedHamSettings, runs: Sequence[RecordedRun], seed: int, log: Path | None
) -> TrainedModel:
    file = pbm.train(runs, pbm.FITTED)
    network, progress = ham.train_guarded(runs, file.twin(), seed, settings, log)
    trained = _trained_model(GuardedHamPredictor(network), network, settings, progress)

    def save(out: Path, facts: Mapping[str, Any]) -> None:
        _save_twin(file, out, facts)
        trained.save(out, {**facts, "twin_sha256": file.twin().sha256})

    return replace(trained, save=save)


def over(file: TwinFile) -> Mapping[str, Train]:
    """Models over a twin that is given, such as one that a diagnosis has found, by name.

    What the file says is to be fitted is fitted on the training parts; all else stays as it is.
    Errors : DataError for another step than the runs'
    """
    if file.sample_s != ham.STEP_S:
        raise DataError(f"twin: sample_s: {file.sample_s:g}, but the runs are trained on at {ham.STEP_S:g} s")
    return {TWIN_GIVEN: partial(_train_given, file), HAM_GIVEN: partial(_train_guarded_given, file)}


def _train_given(file: TwinFile, runs: Sequence[RecordedRun], seed: int, log: Path | None) -> TrainedModel:
    known = _known_twin(file, runs)
    return TrainedModel(Pbm(known.twin()), {}, _origin(file, runs), partial(_save_given, known))


def _train_guarded_given(
    file: TwinFile, runs: Sequence[RecordedRun], seed: int, log: Path | None
) -> TrainedModel:
    settings = ham.GuardedHamSettings()
    known = _known_twin(file, runs)
    network, progress = ham.train_guarded(runs, known.twin(), seed, settings, log)
    trained = _trained_model(GuardedHamPredictor(network), network, settings, progress)

    def save(out: Path, facts: Mapping[str, Any]) -> None:
        _save_given(known, out, facts)
        trained.save(out, {**facts, "twin_sha256": known.twin().sha256})

    return replace(trained, progress={**trained.progress, **_origin(file, runs)}, save=save)


def _known_twin(file: TwinFile, runs: Sequence[RecordedRun]) -> TwinFile:
    return fit_twin(file, split_all(runs).train).file if file.to_fit() else file


def _origin(file: TwinFile, runs: Sequence[RecordedRun]) -> dict[str, Any]:
    """Return whether the twin knows only these runs: one that was fitted on
    others may have seen the test data.
    """
    told = file.provenance.get("data_sha256")
    return {"twin_data_sha256": told, "twin_is_of_these_runs": told == data_sha256(runs)}


def _save_given(file: TwinFile, out: Path, facts: Mapping[str, Any]) -> None:
    provenance = {**file.provenance, "training": dict(facts)}
    write_twin_file(replace(file, provenance=provenance), out / TWIN_FILE)


def _trained_model(
    predictor: Predictor, network: nn.Module, settings: Any, progress: Progress
) -> TrainedModel:
    def save(out: Path, facts: Mapping[str, Any]) -> None:
        save_network(network, out / NETWORK_FILE, facts)

    return TrainedModel(predictor, asdict(settings), asdict(progress), save)


MODELS: Mapping[str, Train] = {
    "linear": partial(_linear, LinearSettings()),
    "pbm": partial(_pbm, pbm.PbmSettings()),
    "lstm": partial(train_window, LstmNet, WindowSettings()),
    "ham": partial(_ham, ham.HamSettings()),
    "pbm_fitted": partial(_pbm, pbm.ONE_MASS),
    # Ours, beyond the paper:
    "linear_ambient": partial(_linear, WITH_AMBIENT),
    "twin": partial(_pbm, pbm.FITTED),
    "lstm_increment": partial(train_window, LstmNet, WindowSettings(predicts_increment=True)),
    "ham_guarded": partial(_train_guarded, ham.GuardedHamSettings()),
}
TWIN_GIVEN, HAM_GIVEN = "twin_given", "ham_given"
SEEDED = ("lstm", "ham", "lstm_increment", "ham_guarded", HAM_GIVEN)  # others come out the same every time
GIVEN = {"pbm": (TWIN_GIVEN,), "ham": (HAM_GIVEN,)}  # of `over`, by subcommand
FAMILIES = {  # subcommand -> models, the paper's first
    "linear": ("linear", "linear_ambient"),
    "pbm": ("pbm", "pbm_fitted", "twin"),
    "lstm": ("lstm", "lstm_increment"),
    "ham": ("ham", "ham_guarded"),
}
