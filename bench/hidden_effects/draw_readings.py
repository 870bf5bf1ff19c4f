"""Readings of sensors: noise, steps, in hard cases holes and spikes; and the part that is given."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import GIVEN_ROWS, STEP_S
from bench.hidden_effects.equations_inputs import Floats
from edge.formats.run_file import RecordedRun

FIRST_DAY = datetime(2026, 3, 2, tzinfo=UTC)
HUMIDITY_NOISE_PCT, AMBIENT_NOISE_K, AMBIENT_STEP_K = 0.4, 0.05, 0.1


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
