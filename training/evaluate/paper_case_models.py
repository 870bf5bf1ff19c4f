"""The twins of the paper's case, the models over them, and the truth that they are compared with."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.formats.run_file import RecordedRun
from edge.models.pbm import Pbm
from edge.twin.effects.library import USUAL_EFFECTS, acting_effects
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.profiles.record import RecordedRow, paths, read, record
from training.data.datasets import data_sha256, test_run, training_runs
from training.data.pairs import split_all
from training.evaluate.scores import TrainingScore, score_runs
from training.models.registry import HAM_GIVEN, over
from training.models.saved_training import SavedTraining, remove_guard
from training.models.study import SCENARIOS, Regime, TrainingJob, validity
from training.models.twin_step import beyond_a_graph

DISTURBANCES = ("sensor_noise", "sensor_step", "ambient_diurnal", "ambient_wander", "power_run_variation",
                "power_wander")  # fmt: skip
QUIET = {"sensor_noise": 0.0, "sensor_step": 0.0}
PROFILE = 9  # a hot one of the training runs, on the board seed that it was recorded with
SIZES: Mapping[str, tuple[str, Callable[[ChamberParameters], float], str]] = {
    "infiltration": ("F_inf", lambda p: p.air.leak_flow_m3_s, "m³/s"),
    "wall_mass": (
        "C_w",
        lambda p: p.cover.areal_mass_kg_m2 * p.cover.heat_capacity_j_kg_k * p.box.cover_m2,
        "J/K",
    ),
    "soil_mass": ("C_s", lambda p: p.soil.capacity_j_k, "J/K"),
    "extra_capacity": ("kC", lambda p: p.air.contact_capacity_factor, ""),
    "heater_efficiency": ("eta", lambda p: p.heater.efficiency, ""),
    "fan_effectiveness": ("eps_f", lambda p: p.fan.effectiveness, ""),
    "fan_spinup": ("tau_f", lambda p: p.fan.spinup_s, "s"),
    "imperfect_mixing": ("F_mix", lambda p: p.air.mixing_flow_m3_s, "m³/s"),
    "sensor_lag": ("tau_s", lambda p: p.sensors.air_lag_s, "s"),
    # Of the errors of the two sensors a run shows the difference alone: that is what either has to come to.
    "sensor_bias": ("bias", lambda p: p.sensors.air_bias_k - p.sensors.ambient_offset_k, "K"),
    "ambient_offset": ("b_amb", lambda p: p.sensors.ambient_offset_k - p.sensors.air_bias_k, "K"),
    "ua_drift": ("ua_drift", lambda p: p.cover.ua_drift_per_day, "1/d"),
    "led_gain": ("P_led", lambda p: p.led.power_w, "W"),
}  # those that one of the chamber's values says; the others are many values or none


@dataclass(frozen=True, slots=True)
class Real:
    """An effect that acts in the chamber.

    parameter, value, unit : in the twin's terms; "", None, "" where none of the chamber's values says it
    shows_k : what the sensors' difference of air and room shows of it in a training run's profile, RMS [K]
    candidate : whether the diagnosis may name it
    """

    name: str
    parameter: str
    value: float | None
    unit: str
    shows_k: float
    candidate: bool


def real_effects(rows: Sequence[RecordedRow] | None = None) -> tuple[Real, ...]:
    """Return the effects that are switched on, the largest first. rows : instead of the profile's"""
    parameters, effects = load()
    applied = rows if rows is not None else read(paths()[PROFILE - 1])[1]
    quiet = replace(effects, **QUIET)
    whole = _readings(parameters, quiet, applied)
    found = []
    for field in fields(Effects):
        if getattr(effects, field.name) == 0.0 or field.name in DISTURBANCES:
            continue
        without = _readings(parameters, replace(quiet, **{field.name: 0.0}), applied)
        shows_k = float(np.sqrt(np.mean((whole - without) ** 2)))
        size = _size(field.name, parameters)
        found.append(Real(field.name, *size, shows_k, field.name in USUAL_EFFECTS))
    return tuple(sorted(found, key=lambda real: -real.shows_k))


def _size(name: str, parameters: ChamberParameters) -> tuple[str, float | None, str]:
    if name not in SIZES:
        return "", None, ""
    symbol, value, unit = SIZES[name]
    return symbol, value(parameters), unit


def _readings(parameters: ChamberParameters, effects: Effects, rows: Sequence[RecordedRow]) -> Floats:
    """Return the sensors' difference of air and room at each row [K]."""
    run = record(Chamber(parameters, effects, PROFILE), rows)
    return np.array([row["temp_air_c"] - row["temp_ambient_c"] for row in run])


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
