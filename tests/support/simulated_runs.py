"""Runs that a twin has made, with noise of every kind that a diagnosis reckons with, from fixed seeds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.runs import DiagnosisRuns, diagnosis_runs
from edge.diagnosis.twin_choice import candidates_of
from edge.diagnosis.twin_fit import FitRuns
from edge.formats.run_file import RecordedRun
from edge.twin.effects.library import EFFECTS
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]
Heat = Callable[[Floats, Floats, Floats], Floats]  # of duty, fan and T - T_amb [rows] [W]
STEP_S = 60.0
BOX: Effects = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 10.0}}


@dataclass(frozen=True, slots=True)
class SimulatedNoise:
    """Noise of a simulated run.

    sensor_k, room_k : of a reading [K]; heat_w, heat_tau_s : of a heat of first order [W], [s]
    power_share : of a run's heater power
    """

    sensor_k: float
    room_k: float
    heat_w: float
    heat_tau_s: float
    power_share: float


NOISE = SimulatedNoise(sensor_k=0.1, room_k=0.03, heat_w=0.5, heat_tau_s=600.0, power_share=0.01)
QUIET = SimulatedNoise(sensor_k=1e-6, room_k=0.0, heat_w=0.0, heat_tau_s=600.0, power_share=0.0)


def silent(text: str, share: float = 0.0) -> None:
    """Progress that nobody wants to see."""


@contextmanager
def candidates_only(*names: str) -> Iterator[None]:
    """Let a diagnosis look for these effects alone, and those that are added while it does.

    The time for all others would tell nothing.
    """
    others = EFFECTS.keys() - set(names)

    def few(file: TwinFile, runs: FitRuns) -> list[str]:
        return [name for name in candidates_of(file, runs) if name not in others]

    with patch("edge.diagnosis.diagnose.candidates_of", few):
        yield


def known_effects(effects: Effects = BOX) -> dict[str, dict[str, Value]]:
    """Effects of a twin file, their values exact."""
    return {name: {key: Value(value) for key, value in own.items()} for name, own in effects.items()}


def twin_file(effects: Effects = BOX, noise: SimulatedNoise = NOISE) -> TwinFile:
    """Return a file that knows these effects exactly, and its noise but for its time constant."""
    return TwinFile(
        effects=known_effects(effects),
        sensor={"quantisation_k": 0.0, "noise_sd_k": noise.sensor_k},
        nuisance={"heater_power_run_sd": noise.power_share, "heat_noise_sd_w": noise.heat_w},
    )


def simulate(
    effects: Effects,
    seed: int,
    rows: int = 150,
    noise: SimulatedNoise = NOISE,
    further: Heat | None = None,
    fan: bool = True,
) -> RecordedRun:
    """From rest at the room: duty in steps of 10 to 25 rows, the fan now and then, a room that swings 1.5 K.

    further : a heat that the library has no effect for; fan : False for one that never runs
    """
    draw = np.random.default_rng(seed)
    duty = _stairs(draw, rows, (10, 25), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    blown = float(fan) * _stairs(draw, rows, (6, 16), [0.0, 0.0, 1.0])
    light = _stairs(draw, rows, (20, 40), [0.0, 0.5, 1.0])
    time_s = STEP_S * np.arange(rows)
    room = 21.0 + 1.5 * np.sin(2.0 * np.pi * time_s / 7200.0 + seed)
    twin = BoxTwin(effects=effects, step_s=STEP_S)
    power = duty * (1.0 + noise.power_share * draw.standard_normal())
    heat_w = coloured_noise(draw, rows, noise)
    temp = _run(twin, power, blown, room, heat_w, light)
    if further is not None:
        # Heat that depends on the temperature it makes: to its fixed point.
        for _ in range(20):
            temp = _run(twin, power, blown, room, heat_w + further(duty, blown, temp - room), light)
    columns = {
        "time_s": time_s,
        "temp_air_c": np.round(temp + noise.sensor_k * draw.standard_normal(rows), 4),
        "temp_ambient_c": np.round(room + noise.room_k * draw.standard_normal(rows), 4),
        "heater_duty": duty,
        "fan_on": blown,
        "light": light,
    }
    facts = {"role": "train", "start_utc": "2026-07-01T08:00:00Z"}
    return RecordedRun(columns, facts, Path(f"run_{seed:02d}.csv"))


def coloured_noise(draw: np.random.Generator, rows: int, noise: SimulatedNoise) -> Floats:
    """Heat of first order, constant over a row [rows] [W]."""
    decay = np.exp(-STEP_S / noise.heat_tau_s)
    fresh = noise.heat_w * draw.standard_normal(rows)
    for k in range(1, rows):
        fresh[k] = decay * fresh[k - 1] + np.sqrt(1.0 - decay**2) * fresh[k]
    return fresh


def as_diagnosis_runs(
    runs: Sequence[RecordedRun], test: Sequence[RecordedRun] = (), file: TwinFile | None = None
) -> DiagnosisRuns:
    """Return runs as a diagnosis needs them, by their file names."""
    train, later = ([(str(run.path), run) for run in some] for some in (runs, test))
    return diagnosis_runs(train, later, file or twin_file())


def change_run(
    run: RecordedRun, facts: Mapping[str, str] | None = None, **columns: Floats | None
) -> RecordedRun:
    """Return the run with some columns replaced (None: without it) and some facts added."""
    found = {**run.columns, **columns}
    kept = {name: values for name, values in found.items() if values is not None}
    return replace(run, columns=kept, facts={**run.facts, **(facts or {})})


def _stairs(draw: np.random.Generator, rows: int, lengths: tuple[int, int], levels: list[float]) -> Floats:
    parts: list[Floats] = []
    while sum(map(len, parts)) < rows:
        parts.append(np.full(draw.integers(*lengths), draw.choice(levels)))
    return np.concatenate(parts)[:rows]


def _run(twin: BoxTwin, power: Floats, fan: Floats, room: Floats, heat_w: Floats, light: Floats) -> Floats:
    start = at_rest(twin, room[0], room[0])
    later = twin.rollout(
        start,
        power[None, :-1],
        fan[None, :-1],
        room[:-1],
        source=heat_w[:-1] / twin.system.air_capacity_j_k,
        conditions={"light": light[None, :-1]},
    )
    return np.concatenate([room[:1], later[0]])
