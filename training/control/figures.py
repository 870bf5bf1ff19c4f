"""One run in figures: pure functions of its columns.

Row k's command holds from its time to the next, so the air at row k + 1 is judged by the reference of row k.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.names import HEATER_MAX_W
from training.control.closed_loop import ClosedLoopLog

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Mean:
    """Mean of n seeds, and half the width of its interval; infinite for one seed alone."""

    value: float
    half: float
    n: int


def mean_of(values: Sequence[float]) -> Mean:
    """Student's t over the seeds. Errors: ValueError without values"""
    if not values:
        raise ValueError("no values: a mean needs one")
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if n == 1:
        return Mean(float(array[0]), float("inf"), 1)
    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, n - 1) * array.std(ddof=1) / np.sqrt(n))
    return Mean(float(array.mean()), half, n)


def ratio(one: Sequence[float], other: Sequence[float]) -> Mean:
    """One by the other, seed by seed."""
    return mean_of([a / b for a, b in zip(one, other, strict=True)])


Floats = NDArray[np.float64]
NEAR_K = 0.5
STEP_K = 1.0  # a change of the reference by so much at once is a step; a ramp's are smaller
BEFORE_STEPS, CYCLE_STEPS, CYCLE_DUTY = 15, 10, 0.5
STEP_WATCHED = 30  # ticks after a step in which it may be overshot
SENSOR_BIAS_K = 0.4  # of the virtual rig's air sensor: `chamber.yaml`, air_bias_k


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of a run. Temperature errors [K], costs as the paper has them, by step.

    mae_measured : by the sensor, noise and all; mae_true, rmse_true : by the mean of the air in the box
    near_pct : steps whose true air is within 0.5 K; overshoot_k : beyond the new reference, mean of the steps
    cost_0, cost_1 : sum of the stage cost by the true air, weight 0 and 1
    sensor_cost_0, sensor_cost_1 : the same by the air where the sensor hangs, its bias with it: what a
        controller can know at best
    before_k : how far that air left the reference, at most, towards a step of it that was still to come
    cycles : starts of the fan within ten minutes of the last one, with half of full heat in between, that
        no step of the reference asks for; both None in figures that are older than they
    """

    mae_measured: float
    mae_true: float
    rmse_true: float
    near_pct: float
    overshoot_k: float
    energy_wh: float
    fan_min: float
    switches: float
    travel: float
    interventions: float
    fallbacks: float
    tokens: float
    cost_0: float
    cost_1: float
    sensor_cost_0: float
    sensor_cost_1: float
    before_k: float | None = None
    cycles: float | None = None


def figures(log: ClosedLoopLog) -> Figures:
    """Return the figures of one run."""
    columns = log.columns
    true, measured = error(columns, "true_air_c"), error(columns, "temp_air_c")
    sensor = error(columns, "sensor_air_c") + SENSOR_BIAS_K
    duty, fan = columns["heater_duty"], columns["fan_on"]
    step_h = float(np.median(np.diff(columns["time_s"]))) / 3600.0
    # The last row drives nothing that was measured, so its inputs cost nothing.
    effort = effort_cost(columns)
    return Figures(
        mae_measured=float(np.nanmean(np.abs(measured))),
        mae_true=float(np.mean(np.abs(true))),
        rmse_true=float(np.sqrt(np.mean(true**2))),
        near_pct=100.0 * float(np.mean(np.abs(true) <= NEAR_K)),
        overshoot_k=overshoot_k(columns["reference_c"], columns["true_air_c"]),
        energy_wh=float(duty[:-1].sum()) * HEATER_MAX_W * step_h,
        fan_min=float(fan[:-1].sum()) * step_h * 60.0,
        switches=fan_switches(fan),
        travel=float(np.abs(np.diff(duty)).sum()),
        interventions=float(sum(log.changes.values())),
        fallbacks=float(sum(log.instead.values())),
        tokens=float(log.tokens),
        cost_0=tracking_cost(true),
        cost_1=tracking_cost(true) + effort,
        sensor_cost_0=tracking_cost(sensor),
        sensor_cost_1=tracking_cost(sensor) + effort,
        before_k=before_k(columns["reference_c"], sensor),
        cycles=float(cycles(duty, fan, columns["reference_c"])),
    )


def fan_switches(fan: Floats) -> float:
    """Return how often the relay switches. fan : share of each step, from its beginning, in which it is on"""
    before = np.append(0.0, fan[:-1])
    return float(((fan > 0.0) != (before >= 1.0)).sum() + ((fan > 0.0) & (fan < 1.0)).sum())


def before_k(reference: Floats, error_k: Floats) -> float:
    """How far the air left the reference towards a step of it before it came, the most of all steps [K].

    reference : [N]; error_k : [N - 1], after each step, looked at for `BEFORE_STEPS`
    """
    changes = np.diff(reference)
    steps = np.flatnonzero(np.abs(changes) >= STEP_K) + 1
    watched = [k for k in steps.tolist() if k >= BEFORE_STEPS]
    left = [left_k(np.sign(changes[k - 1]) * error_k[k - BEFORE_STEPS : k]) for k in watched]
    return max(left, default=0.0)


def left_k(towards_k: Floats) -> float:
    """Return how far the air left the reference in one direction, at most [K].

    towards_k [N] : error in that direction; air on its way back from further out has not left it again
    """
    nearest = np.maximum(np.minimum.accumulate(towards_k), 0.0)
    return float((towards_k - nearest).max(initial=0.0))


def cycles(duty: Floats, fan: Floats, reference: Floats) -> int:
    """Return the starts of the fan within `CYCLE_STEPS` of the last one, with `CYCLE_DUTY` in between.

    duty, fan, reference : [N] each. A step of the reference, soon or just now, asks for both: not counted
    """
    starts = np.flatnonzero((fan > 0.0) & ~(np.append(0.0, fan[:-1]) >= 1.0)).tolist()

    def is_cycle(last: int, start: int) -> bool:
        asked = np.abs(np.diff(reference[last : start + BEFORE_STEPS])).max(initial=0.0) >= STEP_K
        return bool(start - last <= CYCLE_STEPS and not asked and duty[last:start].max() >= CYCLE_DUTY)

    return sum(is_cycle(last, start) for last, start in pairwise(starts))


def error(columns: Mapping[str, Floats], air: str) -> Floats:
    """Air at the end of each step less the step's reference [N - 1] [K]."""
    return np.asarray(columns[air][1:] - columns["reference_c"][:-1])


def tracking_cost(errors: Floats) -> float:
    """Return the paper's cost of tracking, without effort."""
    return float(TRACKING_WEIGHT * (errors**2).sum())


def effort_cost(columns: Mapping[str, Floats]) -> float:
    """Return the paper's cost of heater and fan with weight 1."""
    duty, fan = columns["heater_duty"][:-1], columns["fan_on"][:-1]
    return float((duty**2).sum() + fan.sum())


def overshoot_k(reference: Floats, air: Floats) -> float:
    """How far the air goes beyond a new reference; mean of the steps [K].

    reference, air : [N]; watched for `STEP_WATCHED` rows or until it changes again; 0 without steps
    """
    changes = np.flatnonzero(np.diff(reference) != 0.0) + 1
    found = []
    for row in map(int, changes):
        step = reference[row] - reference[row - 1]
        if abs(step) < STEP_K:
            continue
        later = changes[changes > row]
        end = min(row + STEP_WATCHED, int(later[0]) if len(later) else len(reference))
        beyond = np.sign(step) * (air[row + 1 : end + 1] - reference[row])
        found.append(max(float(beyond.max(initial=0.0)), 0.0))
    return float(np.mean(found)) if found else 0.0


@dataclass(frozen=True, slots=True)
class DecisionTime:
    """Decision times of one run by the machine's clock, never the same twice [ms]."""

    median_ms: float
    p99_ms: float


def decision_time(log: ClosedLoopLog) -> DecisionTime:
    """How long decisions took."""
    times = log.columns["solve_ms"]
    return DecisionTime(float(np.median(times)), float(np.percentile(times, 99.0)))
