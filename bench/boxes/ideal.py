"""python -m bench.boxes.ideal: what an hour is worth to one who knows the kind as well as can be.

The box's own equations in place of a twin. How its tolerances are spread is known (siblings.py), an hour of
step tests says the rest: forecasts are averaged over draws from the posterior. Beside it the box itself, with
its true parts. Neither knows the sun or the mains of the day that judges, as no twin does. Compared with what
is learnt from six hours without a prior, and from an hour with one, where `bench.boxes.fleet --out` has it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from bench.boxes.draw import draw_box
from bench.boxes.facts import BoxFacts
from bench.boxes.fleet import (
    LITTLE_H,
    MINUTE_S,
    FleetBox,
    NewBoxRow,
    boxes_of,
    first_hours,
    parser_of,
    place_of,
    record_day,
    record_tests,
)
from bench.boxes.physics import BoxPhysics
from bench.boxes.pulses import relay_share
from bench.boxes.siblings import HEATER, SUN, build
from bench.header import header
from edge.core.sweep import sweep
from edge.formats.reader import read_json
from edge.formats.run_file import RecordedRun, read_run, resample

Floats = NDArray[np.float64]
ROW_S = 10.0
PULSE_S = 5.0  # of the heater's window, looked at in parts
SUN_S, MAINS_S = 600.0, 900.0  # between two knots, as in disturbances.py
SUNS, MAINS = 7, 5  # knots of an hour
SMOOTHED = 7  # rows of the room's sensor, which is as coarse as the other
ROOMS_C = 6.0, 31.0  # where nothing measures the room
NOISE_K = 0.03  # least error of a reading; the box's inner step alone makes up to 0.012 K
MEAN_SUN = 0.06  # of a day, as a share of its peak: clouds, and the hours that the window has it
TRIES = 8  # slopes on the way to the best place
DRAWS, SEED = 10, 1  # from the posterior
UNKNOWN = 64  # more than a box has tolerances


class Quantiles:
    """Draws that are given: each is the quantile that follows. used : how many were"""

    def __init__(self, given: Floats) -> None:
        self.given, self.used = given, 0

    def even(self, low: float, high: float) -> float:
        """Return the next quantile of an even spread."""
        self.used += 1
        return float(low + (high - low) * self.given[self.used - 1])

    def log(self, low: float, high: float) -> float:
        """Return the next quantile of a spread that is even in the logarithm."""
        return float(np.exp(self.even(np.log(low), np.log(high))))


@dataclass(frozen=True, slots=True)
class GivenAround:
    """The room [°C] at times [s], knots of the sun [W/m²] and of the mains (1: nominal)."""

    time_s: Floats
    room_c: Floats
    sun: Floats
    mains: Floats

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return room, sun and mains."""
        sun = np.interp(time_s, SUN_S * np.arange(len(self.sun)), self.sun)
        mains = np.interp(time_s, MAINS_S * np.arange(len(self.mains)), self.mains)
        return float(np.interp(time_s, self.time_s, self.room_c)), float(sun), float(mains)


class Hour:
    """The first hour of a box's tests, to one who knows its design.

    A place z is a number for each unknown, of the standard normal distribution: tolerances, then knots of sun
    and mains, then the room where nothing measures it.
    """

    def __init__(self, design: BoxFacts, run: RecordedRun) -> None:
        self.design, self.run = design, run
        unknown = Quantiles(np.full(UNKNOWN, 0.5))
        _built(design, unknown)
        self.parts = unknown.used
        self.size = self.parts + SUNS + MAINS + 1
        self._low, self._high = told_between(run.columns["temp_air_c"], design.air.step_k)

    def box(self, z: Floats) -> BoxFacts:
        """Return the box at a place."""
        return _built(self.design, Quantiles(norm.cdf(z[: self.parts])))

    def room_c(self, run: RecordedRun, z: Floats) -> Floats:
        """Return the room at the rows of a run. Its sensor's error is the kind's, so it is known."""
        sensor, rows = self.design.room_sensor, np.arange(len(run))
        if sensor is None:
            return np.full(len(run), np.interp(norm.cdf(z[-1]), (0.0, 1.0), ROOMS_C))
        shown = run.columns["temp_ambient_c"]
        known = np.isfinite(shown)
        room = np.interp(rows, rows[known], shown[known]) - sensor.bias
        padded = np.pad(room, SMOOTHED // 2, mode="edge")
        return np.convolve(padded, np.full(SMOOTHED, 1.0 / SMOOTHED), mode="valid")

    def misses(self, z: Floats) -> Floats:
        """Return by how many sds readings lie outside what they told, then z, which the prior wants small."""
        room, u = self.design.room, norm.cdf(z[self.parts : -1])
        sun = room.sun_peak_w_m2 * SUN[1] * u[:SUNS] ** 3  # little most of the time
        mains = 1.0 + room.mains_share * (2.0 * u[SUNS:] - 1.0)
        shown = simulate(self.box(z), self.run, self.room_c(self.run, z), sun, mains)
        outside = np.maximum(shown - self._high, 0.0) + np.minimum(shown - self._low, 0.0)
        told = np.isfinite(outside)
        return np.concatenate((outside[told] / max(self.design.air.noise_sd_k, NOISE_K), z))

    def places(self) -> Floats:
        """Return draws from the posterior [DRAWS, size], as a normal distribution about its best place."""
        found = least_squares(self.misses, np.zeros(self.size), diff_step=1e-2, max_nfev=TRIES)
        spread = np.linalg.cholesky(np.linalg.inv(found.jac.T @ found.jac))
        standard = np.random.default_rng([self.design.seed, SEED]).standard_normal((DRAWS, self.size))
        return np.asarray(found.x + standard @ spread.T)

    def day_error_k(self, day: RecordedRun) -> float:
        """Return the mean error of the mean forecast of another day."""
        forecasts = [self.forecast(self.box(z), day, z) for z in self.places()]
        return error_k(np.mean(forecasts, axis=0), day)

    def forecast(self, facts: BoxFacts, day: RecordedRun, z: Floats) -> Floats:
        """Return the readings of a day with its mean sun."""
        sun = np.array([MEAN_SUN * self.design.room.sun_peak_w_m2])
        return simulate(facts, day, self.room_c(day, z), sun, np.ones(1))


def _built(design: BoxFacts, draws: Quantiles) -> BoxFacts:
    return build(design, draws.even(*HEATER), draws)


def told_between(shown_c: Floats, step_k: float) -> tuple[Floats, Floats]:
    """Return the lowest and the highest that a sensor with steps can have felt.

    A row is a mean of several looks. Where they differed, the truth was at the edge of two steps.
    """
    steps = shown_c / step_k
    edge = step_k * (np.floor(steps) + 0.5)
    is_one = np.abs(steps - np.round(steps)) < 1e-3
    middle = step_k * np.round(steps)
    return np.where(is_one, middle - 0.5 * step_k, edge), np.where(is_one, middle + 0.5 * step_k, edge)


def simulate(facts: BoxFacts, run: RecordedRun, room_c: Floats, sun: Floats, mains: Floats) -> Floats:
    """Return the readings of a box that begins at rest in its room, at the rows of a run [N]."""
    time_s, duty, fan = (run.columns[name] for name in ("time_s", "heater_duty", "fan_on"))
    physics = BoxPhysics(facts, GivenAround(time_s, room_c, sun, mains))
    states = [physics.start(1, float(time_s[0]))]
    for k, step_s in enumerate(np.diff(time_s)):
        parts = math.ceil(step_s / PULSE_S)
        part_s, now = float(step_s) / parts, states[-1]
        for begin_s in (float(time_s[k]) + part_s * np.arange(parts)).tolist():
            heat = float(relay_share(float(duty[k]), begin_s, part_s))
            now = physics.step(now, begin_s, part_s, heat, float(fan[k]))
        states.append(now)
    return physics.reading_c(np.concatenate(states))


def error_k(forecast: Floats, day: RecordedRun) -> float:
    """Return the mean error of a forecast."""
    return float(np.nanmean(np.abs(forecast - day.columns["temp_air_c"])))


@dataclass(frozen=True, slots=True)
class Limits:
    """Errors over another day [K]. hour : by the posterior of the box's own equations; itself : true parts"""

    box: FleetBox
    hour: float
    itself: float


def limits(out: Path, box: FleetBox) -> Limits:
    """Return what can be known of a box."""
    record_tests(out, box)
    record_day(out, box)
    tests, day = (read_run(out / f"{box.name}.{name}.csv") for name in ("tests", "day"))
    day = resample(day, MINUTE_S)
    hour = Hour(draw_box(box.design), resample(first_hours(tests, LITTLE_H), ROW_S))
    place = np.zeros(hour.size)
    place[-1] = norm.ppf(np.interp(box.facts.room.mean_c, ROOMS_C, (0.0, 1.0)))
    itself = hour.forecast(box.facts, day, place)
    return Limits(box, hour.day_error_k(day), error_k(itself, day))


def learnt(path: Path) -> float:
    """Return the error of a kept row; inf where nothing was learnt, NaN where none is kept."""
    if not path.exists():
        return np.nan
    row: NewBoxRow = read_json(NewBoxRow, path)
    return np.inf if row.error_k is None else row.error_k


def lines(out: Path, found: Sequence[Limits], built: int) -> Iterator[str]:
    """Yield a line for each box, then how often each is as good as six hours."""
    yield f"{'box':<8}{'6 h':>8}{'1 h and prior':>16}{'1 h, own equations':>22}{'true parts':>14}"
    better, known = np.zeros(3, dtype=int), 0
    for item in found:
        name = item.box.name
        fleet = [FleetBox(item.box.design, number) for number in range(1, built + 1)]
        six = learnt(out / f"{name}.6-h.json")
        ways = learnt(place_of(out, fleet) / f"{name}.1-h-and-prior.json"), item.hour, item.itself
        better += np.array(ways) <= six
        known += not np.isnan(six)
        yield f"{name:<8}{six:8.2f}{ways[0]:16.2f}{ways[1]:22.2f}{ways[2]:14.2f}"
    counts = "".join(f"{n:>{width}d}" for n, width in zip(better, (16, 22, 14), strict=True))
    yield f"{'as good as 6 h':<16}{counts}  of {known}"


def main(words: Sequence[str] | None = None) -> int:
    """Print a table of boxes, beside what `bench.boxes.fleet` measured of them."""
    given = parser_of("ideal", __doc__).parse_args(words)
    print("\n".join(header()), flush=True)
    boxes = boxes_of(given)
    given.out.mkdir(parents=True, exist_ok=True)
    found = sweep(partial(limits, given.out), boxes, given.workers, given.dask)
    print("\n".join(lines(given.out, found, given.built)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
