"""`greenhouse-train heated-box`: the same kinds of models on a real box that somebody else measured.

14 runs of a plywood box with a heating plate, ten minutes each (ESPerimentino PID, repository
grobx/unimi-embedded-project, CC BY 4.0); not part of this repository. The first five by date train, the next
three validate, six are only forecast. What these logs can't tell: the fan was always on, so it is no input;
the room was not measured, so one constant is fitted for all runs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from edge.core.errors import DataError
from edge.core.predictor import Floats, Predictor
from edge.formats.run_file import RecordedRun, inside_names, read_run, resample
from edge.formats.run_lines import OPTION_WITHOUT
from edge.formats.table import Table
from edge.models.arx import Arx
from edge.models.fit_arx import fit_arx
from edge.models.pbm import Pbm
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import TwinFit, fit_twin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from training.data.datasets import Split
from training.models import ham
from training.models.fit_network import make_deterministic
from training.models.predictors import GuardedHamPredictor, WindowPredictor
from training.models.rollout import START_ROWS
from training.models.summary import spread
from training.models.window_network import LstmNet, WindowSettings, train_on

STEP_S = 10.0
HORIZONS_S = (10, 30, 60, 120, 300)
TRAINING, VALIDATION, RUNS = 5, 3, 14
SEEDS = (0, 1, 2, 3, 4)
FILE = "heated_box.txt"
HEATER_W = 42.0  # 12 V and under 3.5 A; only its ratio to capacity and loss is known, so it is given
VOLUME_M3 = 0.01  # any: the fitted capacity is a multiple of its air's
SOURCE = (
    "they are the logs *_fan.csv of ESPerimentino PID by Giuseppe Roberti, https://github.com/grobx/"
    "unimi-embedded-project (CC BY 4.0), as run files: time_s, temp_air_c, heater_duty; name their folder"
)

ORDERS = tuple((p, q) for p in (1, 2, 3, 4, 6, 8, START_ROWS) for q in (1, 2, 3, 4, 6))
ONE_MASS = ("extra_capacity", "wall_loss")
HEATER_MASS = (*ONE_MASS, "heater_lag")


@dataclass(frozen=True, slots=True)
class Data:
    """Runs at STEP_S: what trains, what validates, what is only forecast."""

    parts: Split
    test: list[RecordedRun]


@dataclass(frozen=True, slots=True)
class FittedBox:
    """A fitted one: its predictor, and the room that was fitted with it [°C]."""

    predictor: Pbm
    ambient_c: float
    text: str


def run(data: Path, results: Path) -> int:
    """Fit, forecast, print and save the table. Errors: DataError where the data are missing."""
    make_deterministic(0)
    found = read_data(data)
    text = "\n".join(lines(found))
    print(text)
    results.mkdir(parents=True, exist_ok=True)
    (results / FILE).write_text(text + "\n", encoding="utf-8")
    return 0


def read_data(folder: Path) -> Data:
    """By the dates in the files' names: what comes later is not known when a model is fitted."""
    paths = sorted(folder.glob("*.csv"))
    if len(paths) != RUNS:
        raise DataError(f"{folder}: {len(paths)} run files of {RUNS}; {SOURCE}")
    runs = [_at_step(read_run(path, OPTION_WITHOUT)) for path in paths]
    end = TRAINING + VALIDATION
    return Data(Split(runs[:TRAINING], runs[TRAINING:end]), [_as(one, "test") for one in runs[end:]])


def lines(data: Data, seeds: Sequence[int] = SEEDS) -> list[str]:
    """Return the table with its data's description."""
    mass, lag = (fit_box(data.parts.train, effects) for effects in (ONE_MASS, HEATER_MASS))
    arx = fit_arx(
        data.parts.train, data.parts.validate, STEP_S, ORDERS, fan_input=None, with_ambient=False
    ).model
    cells = tuple(
        (name, *(spread(column) for column in np.stack(found).T))
        for name, found in _rows(data, arx, mass, lag, seeds).items()
    )
    note = (
        f"Forecasts with the inputs that then stood, from every row after the first {START_ROWS} of the test "
        f"runs; networks: mean ± sd over {len(seeds)} seeds. The first four models are the paper's kinds.\n"
        "The paper's LSTM gives levels, learnt here from 264 windows up to 23.7 °C where test runs reach "
        "24.7 °C.\nOf increments, all else as in the paper, it was best on the validation runs (no better "
        "there without\ndropout, with or without four times the patience).\n"
        f"Linear: p = {len(arx.temp)}, q = {len(arx.heater)}. One mass: {mass.text}.\n"
        f"With the heater's mass: {lag.text}."
    )
    title = (
        f"{TRAINING} runs train, {VALIDATION} validate, {len(data.test)} are forecast; steps of {STEP_S:g} s"
    )
    heads = ("MAE [K] at horizon", *(f"{horizon} s" for horizon in HORIZONS_S))
    return ["greenhouse-train heated-box", "", *Table(title, heads, cells, note).text()]


def _rows(
    data: Data, arx: Arx, mass: FittedBox, lag: FittedBox, seeds: Sequence[int]
) -> dict[str, list[Floats]]:
    """By model, MAE at each horizon by seed."""
    by_mass, by_lag = (parts_with_room(data.parts, box.ambient_c) for box in (mass, lag))

    def scores(predictor: Predictor, box: FittedBox = mass) -> Floats:
        return maes(predictor, data.test, box.ambient_c)

    return {
        "persistence": [_persistence(data.test)],
        "Linear": [scores(arx)],
        "PBM, one mass": [scores(mass.predictor)],
        "LSTM of increments": [scores(_lstm(by_mass, seed, increment=True)) for seed in seeds],
        "HAM over the one mass": [scores(_ham(by_mass, mass, seed, guarded=False)) for seed in seeds],
        "twin with the heater's mass": [scores(lag.predictor, lag)],
        "LSTM of levels": [scores(_lstm(by_mass, seed, increment=False)) for seed in seeds],
        "HAM over that twin, guarded": [scores(_ham(by_lag, lag, seed, guarded=True), lag) for seed in seeds],
    }


def fit_box(runs: Sequence[RecordedRun], effects: Sequence[str]) -> FittedBox:
    """Capacity, gain (by the loss at a given power) and room of the box, and more with more effects."""
    values = {
        name: {item.name: Value(item.start, fit=True) for item in EFFECTS[name].parameters}
        for name in effects
    }
    geometry = {**TwinFile().geometry, "heater_max_w": Value(HEATER_W), "volume_m3": Value(VOLUME_M3)}
    without_room = [
        replace(run, columns={k: v for k, v in run.columns.items() if k != "temp_ambient_c"}) for run in runs
    ]
    fit = fit_twin(TwinFile(geometry=geometry, sample_s=STEP_S, effects=values), without_room)
    if fit.ambient_c is None:
        raise DataError("heated box: no room was fitted")
    twin = fit.file.twin()
    return FittedBox(Pbm(twin), fit.ambient_c.value, _text(fit, twin.system.air_capacity_j_k))


def _text(fit: TwinFit, air_capacity_j_k: float) -> str:
    """Gain, time constants, room; which of two constants is the air's its temperature can't tell."""
    named = {place[-1]: item.value for place, item in fit.estimates.items()}
    constants = [air_capacity_j_k / named["UA"]] + [named[key] for key in ("tau_h",) if key in named]
    minutes = " and ".join(f"{constant / 60.0:.1f}" for constant in sorted(constants))
    room = f"room {fit.ambient_c.value:.1f} °C" if fit.ambient_c else "no room"
    bound = " (at its bound: these runs don't tell it)" if fit.ambient_c and fit.ambient_c.at_bound else ""
    return f"gain {HEATER_W / named['UA']:.1f} K, time constant {minutes} min, {room}{bound}"


def maes(predictor: Predictor, runs: Sequence[RecordedRun], ambient_c: float) -> Floats:
    """MAE at HORIZONS_S [K], over all rows of all runs from which that far was measured."""
    return _errors(runs, lambda run: _forecasts(predictor, run, ambient_c))


def _persistence(runs: Sequence[RecordedRun]) -> Floats:
    steps = _steps()
    return _errors(
        runs,
        lambda run: [np.full(steps[-1], run.columns["temp_air_c"][now]) for now in _starts(run)],
    )


def _errors(runs: Sequence[RecordedRun], forecast: Callable[[RecordedRun], Sequence[Floats]]) -> Floats:
    missed: dict[int, list[float]] = {step: [] for step in _steps()}
    for run in runs:
        measured = run.columns["temp_air_c"]
        for now, temps in zip(_starts(run), forecast(run), strict=True):
            for step, found in missed.items():
                if now + step < len(measured):
                    found.append(abs(float(temps[step - 1] - measured[now + step])))
    return np.array([np.nanmean(found) for found in missed.values()])


def _forecasts(predictor: Predictor, run: RecordedRun, ambient_c: float) -> list[Floats]:
    columns: Mapping[str, Floats] = inside_names(_with_room(run, ambient_c))
    found = []
    for now in _starts(run):
        ahead = {name: values[now : now + _steps()[-1]] for name, values in columns.items()}
        controls = np.stack([ahead["heater_duty"], ahead["fan_on"]], axis=-1)
        history = {name: values[: now + 1] for name, values in columns.items()}
        found.append(predictor.rollout(history, controls[None], ahead)[0])
    return found


def _starts(run: RecordedRun) -> range:
    return range(START_ROWS - 1, len(run) - 1)


def _steps() -> tuple[int, ...]:
    return tuple(round(horizon / STEP_S) for horizon in HORIZONS_S)


def _lstm(parts: Split, seed: int, increment: bool) -> Predictor:
    settings = WindowSettings(predicts_increment=increment)
    return WindowPredictor(train_on(LstmNet, parts, seed, settings)[0])


def _ham(parts: Split, box: FittedBox, seed: int, guarded: bool) -> Predictor:
    settings = ham.GuardedHamSettings()
    network, _ = ham.train_guarded_on(parts, box.predictor.twin, seed, settings)
    if not guarded:
        network.margin.copy_(torch.full_like(network.margin, torch.inf))
    return GuardedHamPredictor(network)


def parts_with_room(parts: Split, ambient_c: float) -> Split:
    """Return the parts with a room of this temperature [°C]."""
    return Split(
        [_with_room(run, ambient_c) for run in parts.train],
        [_with_room(run, ambient_c) for run in parts.validate],
    )


def _at_step(run: RecordedRun) -> RecordedRun:
    """At STEP_S, with a fan that never changes."""
    found = resample(run, STEP_S)
    return replace(found, columns={**found.columns, "fan_on": np.zeros(len(found))})


def _with_room(run: RecordedRun, ambient_c: float) -> RecordedRun:
    return replace(run, columns={**run.columns, "temp_ambient_c": np.full(len(run), ambient_c)})


def _as(run: RecordedRun, role: str) -> RecordedRun:
    return replace(run, facts={**run.facts, "role": role})
