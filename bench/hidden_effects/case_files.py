"""A case's files: readings of sensors, the twin file that is given, and the truth in another folder.

Readings have noise and steps, in hard cases holes and spikes. Of the known effects the twin file gives some
exactly, some to 5 %, and leaves some open.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import GENERATOR_VERSION, GIVEN_ROWS, STEP_S, HiddenCase
from bench.hidden_effects.inputs import Floats
from edge.formats.run_file import RecordedRun, write_run
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import TwinFile, write_twin_file
from edge.twin.value import Value

FIRST_DAY = datetime(2026, 3, 2, tzinfo=UTC)
HUMIDITY_NOISE_PCT, AMBIENT_NOISE_K, AMBIENT_STEP_K = 0.4, 0.05, 0.1
REL_SD = 0.05
START_SD = 0.15  # of where a fit begins
LOSSES = ("wall_loss", "wall_mass", "longwave_radiation")


@dataclass(frozen=True, slots=True)
class Sensing:
    """How temperatures are read: noise sd and step [K], and for a hard case holes and spikes."""

    noise_k: float
    step_k: float
    hard: bool = False


def draw_sensing(rng: Generator, hard: bool) -> Sensing:
    """Draw the sensors of one case."""
    if hard:
        return Sensing(rng.uniform(0.2, 0.5), 0.5, True)
    return Sensing(rng.uniform(0.05, 0.1), 0.1)


def read_temps(rng: Generator, clean: Floats, sensing: Sensing, role: str) -> Floats:
    """Temperatures as shown, NaN where missing.

    A test run has neither holes nor spikes: nobody sees them, and forecasts would be scored by them.
    """
    shown = to_steps(clean + rng.normal(0.0, sensing.noise_k, len(clean)), sensing.step_k)
    if sensing.hard and role != "test":
        rows = np.arange(GIVEN_ROWS, len(clean))
        spikes = rng.choice(rows, rng.integers(2, 6), replace=False)
        shown[spikes] += rng.choice([-1.0, 1.0], len(spikes)) * rng.uniform(3.0, 15.0, len(spikes)).round()
        shown[rows[rng.random(len(rows)) < 0.03]] = np.nan
        begin = int(rng.integers(GIVEN_ROWS, len(clean) - 20))
        shown[begin : begin + int(rng.integers(5, 20))] = np.nan
    return shown


def read_ambient(rng: Generator, clean: Floats) -> Floats:
    """Return the room as its own sensor shows it."""
    return to_steps(clean + rng.normal(0.0, AMBIENT_NOISE_K, len(clean)), AMBIENT_STEP_K)


def read_humidity(rng: Generator, clean: Floats) -> Floats:
    """Relative humidity as shown [%]."""
    return np.clip(to_steps(clean + rng.normal(0.0, HUMIDITY_NOISE_PCT, len(clean)), 0.1), 0.0, 100.0)


def to_steps(values: Floats, step: float) -> Floats:
    """Round to whole steps, without the digits that floating point adds."""
    return np.round(np.round(values / step) * step, 6)


def run_of(columns: dict[str, Floats], role: str, day: float, hour: float) -> RecordedRun:
    """Return a run file's content that begins on this day at this hour."""
    rows = len(columns["temp_air_c"])
    start = FIRST_DAY + timedelta(days=float(day), seconds=round(3600.0 * float(hour)))
    facts = {"start_utc": start.strftime("%Y-%m-%dT%H:%M:%SZ"), "role": role}
    return RecordedRun({"time_s": STEP_S * np.arange(rows, dtype=np.float64), **columns}, facts)


def as_given(run: RecordedRun) -> RecordedRun:
    """Return a test run as the workflow gets it: temperatures in the first rows only."""
    temps = run.columns["temp_air_c"].copy()
    temps[GIVEN_ROWS:] = np.nan
    return replace(run, columns={**run.columns, "temp_air_c": temps})


@dataclass(frozen=True, slots=True)
class Knowledge:
    """How well a case's values are known; of nuisances and the sensor's noise, whether they are.

    mode : all exact; all to 5 %; or to 5 % but the loss to be fitted
    """

    mode: Literal["exact", "uncertain", "to_fit"]
    nuisance: bool
    sensor_noise: bool
    day0: bool  # whether the first run's start is told


def draw_knowledge(rng: Generator, weak: bool) -> Knowledge:
    """Draw the knowledge of one case. weak : the hidden effect does less than
    5 % of the known ones, mostly exact then
    """
    odds = (0.75, 0.25, 0.0) if weak else (0.45, 0.4, 0.15)
    mode = rng.choice(["exact", "uncertain", "to_fit"], p=odds)
    return Knowledge(str(mode), *(bool(rng.random() < odds) for odds in (0.75, 0.6, 0.5)))  # type: ignore[arg-type]


def declare_twin(
    rng: Generator,
    effects: Mapping[str, Mapping[str, float]],
    knowledge: Knowledge,
    sensing: Sensing,
    nuisance: Mapping[str, float],
    day0_utc: float,
) -> TwinFile:
    """Return the twin file that the workflow is given."""
    return TwinFile(
        effects={
            name: {key: _value(rng, name, key, item, knowledge) for key, item in own.items()}
            for name, own in effects.items()
        },
        sensor=_sensor(sensing, knowledge.sensor_noise),
        nuisance=dict(nuisance) if knowledge.nuisance else dict.fromkeys(nuisance),
        day0_utc=day0_utc if knowledge.day0 else None,
    )


def exact(
    effects: Mapping[str, Mapping[str, float]],
    sensing: Sensing,
    nuisance: Mapping[str, float],
    day0_utc: float | None,
) -> TwinFile:
    """Return the truth in the library's terms."""
    return TwinFile(
        effects={name: {key: Value(item) for key, item in own.items()} for name, own in effects.items()},
        sensor=_sensor(sensing, True),
        nuisance=dict(nuisance),
        day0_utc=day0_utc,
    )


def _sensor(sensing: Sensing, is_known: bool) -> dict[str, float | None]:
    return {"quantisation_k": sensing.step_k, "noise_sd_k": round(sensing.noise_k, 4) if is_known else None}


def _value(rng: Generator, effect: str, key: str, true: float, knowledge: Knowledge) -> Value:
    """One value, off from the truth by as much as its uncertainty says."""
    off = float(rng.normal())
    parameter = EFFECTS[effect].parameter(key)

    def inside(value: float) -> float:
        return float(f"{min(max(value, parameter.low), parameter.high):.6g}")

    if knowledge.mode == "exact":
        return Value(inside(true))
    if knowledge.mode == "to_fit" and effect in LOSSES:
        return Value(inside(true * (1.0 + START_SD * off)), fit=True)
    return Value(inside(true / (1.0 + REL_SD * off)), rel_sd=REL_SD)


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
