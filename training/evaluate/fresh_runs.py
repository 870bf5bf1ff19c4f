"""Runs that no model has seen, straight from the simulated chamber: for calibration and for coverage.

Profiles are drawn as the training sequences were, with fresh seeds; the readings are made as the daemon makes
them, the trimmed mean of the last 5 s. The daemon itself is left out: 240 runs through it take hours.
"""

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from edge.core.sweep import sweep
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.tick.sensor_health import AVERAGE_S, trimmed_mean
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.profiles.generate import PLANS, SequencePlan, draw
from firmware_protocol.virtual_board.profiles.record import SAMPLE_S, WINDOW_S, RecordedRow, drive

Kind = Literal["calibration", "interpolation", "extrapolation"]
COUNTS: dict[Kind, int] = {"calibration": 100, "interpolation": 100, "extrapolation": 30}
FIRST_SEEDS: dict[Kind, int] = {"calibration": 1000, "interpolation": 2000, "extrapolation": 3000}
ROLES: dict[Kind, str] = {"calibration": "calibrate", "interpolation": "test", "extrapolation": "test"}
HOTTER = SequencePlan(212, (0.70, 1.00), 0.20, 0.15, (8, 30), (39.0, 45.0))  # training ends at 36.9 degC


def runs(
    kind: Kind, folder: Path, count: int | None = None, workers: int = 2, dask: str | None = None
) -> list[RecordedRun]:
    """All runs of one kind, read from `folder` where they were made before, else made and kept there."""
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(FIRST_SEEDS[kind], FIRST_SEEDS[kind] + (COUNTS[kind] if count is None else count))
    missing = [(kind, seed, folder) for seed in seeds if not _path(kind, seed, folder).exists()]
    sweep(keep, missing, workers, dask)
    return [read_run(_path(kind, seed, folder)) for seed in seeds]


def keep(task: tuple[Kind, int, Path]) -> None:
    """Make one run (kind, seed, folder) and write it, whole or not at all."""
    kind, seed, folder = task
    path = _path(kind, seed, folder)
    write_run(replace(make_run(kind, seed), path=path), path)


def make_run(kind: Kind, seed: int) -> RecordedRun:
    """Return the first candidate of this seed whose highest reading lies in
    its plan's band, on the board `seed`.
    """
    plan = HOTTER if kind == "extrapolation" else PLANS[seed % len(PLANS)]
    rng = random.Random(seed)
    while True:
        rows = draw(plan, rng)
        readings = measure(rows, seed, plan.peak_c[1])
        if plan.peak_c[0] <= max(row["temp_air_c"] for row in readings) <= plan.peak_c[1]:
            return _run(rows, readings, {"role": ROLES[kind], "kind": kind, "seed": str(seed)})


def measure(rows: Sequence[RecordedRow], seed: int, stop_above_c: float = np.inf) -> list[dict[str, float]]:
    """Return the readings at each row's time, up to the first that is hotter than `stop_above_c`."""
    parameters, effects = load()
    chamber = Chamber(parameters, effects, seed)
    readings = [chamber.sense()]
    for row in rows[:-1]:
        drive(chamber, SAMPLE_S - WINDOW_S, row)
        readings.append(_last_window(chamber, row))
        if readings[-1]["temp_air_c"] > stop_above_c:
            break
    return readings


def _last_window(chamber: Chamber, row: RecordedRow) -> dict[str, float]:
    """Simulate the last PWM window of a row, second by second, and return the reading at its end."""
    samples = []
    for second in range(1, WINDOW_S + 1):
        on = second <= round(row.heater_duty * WINDOW_S)
        chamber.step(1.0, float(on), bool(row.fan_on), row.light, False)
        if WINDOW_S - second < AVERAGE_S:
            samples.append(chamber.sense())
    return {key: trimmed_mean([sample[key] for sample in samples]) for key in samples[0]}


def _run(
    rows: Sequence[RecordedRow], readings: Sequence[dict[str, float]], facts: dict[str, str]
) -> RecordedRun:
    inputs = {
        "time_s": np.array([row.time_s for row in rows], dtype=np.float64),
        "heater_duty": np.array([row.heater_duty for row in rows]),
        "fan_on": np.array([row.fan_on for row in rows], dtype=np.float64),
    }
    measured = {key: np.array([reading[key] for reading in readings]) for key in readings[0]}
    return RecordedRun(inputs | measured, facts)


def _path(kind: Kind, seed: int, folder: Path) -> Path:
    return folder / f"{kind}_{seed}.csv"
