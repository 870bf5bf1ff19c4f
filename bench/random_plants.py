"""Planning problems of random plants: boxes of any size, heater and fan, within ranges that are plausible."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import FanRules, PlanningProblem

Floats = NDArray[np.float64]
STEP_MIN = 1.0
# Each value is drawn evenly from its range, time constants evenly in their logarithm.
RANGES: Mapping[str, tuple[float, float]] = {
    "air time constant [min]": (5.0, 60.0),
    "heater time constant [min]": (0.5, 8.0),
    "heater dead time [steps]": (0, 3),
    "fan dead time [steps]": (0, 1),
    "rise at full heat [K]": (10.0, 45.0),
    "fall by the fan [K]": (2.0, 25.0),
    "room [degC]": (15.0, 28.0),
    "air above room at the start, share of the rise": (0.0, 0.8),
    "reference above room, share of the rise": (0.1, 0.9),
    "heater's stored heat at the start, share": (0.0, 1.0),
}


def ranges() -> str:
    """Return the ranges as one line."""
    return "; ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in RANGES.items())


def random_problems(count: int, horizon: int, weight: float, seed: int) -> Iterator[PlanningProblem]:
    """Draw `count` problems; the same plants and starts for every horizon and weight."""
    for number in range(count):
        yield _problem(np.random.default_rng([seed, number]), horizon, weight)


def _problem(rng: np.random.Generator, horizon: int, weight: float) -> PlanningProblem:
    """Draw a heater that warms the air, each of first order; the fan cools the air linearly."""
    air_min, heater_min = (np.exp(rng.uniform(*np.log(RANGES[name]))) for name in list(RANGES)[:2])
    heater_late, fan_late = (
        int(rng.integers(int(low), int(high) + 1)) for low, high in list(RANGES.values())[2:4]
    )
    rise, fall, room, above, goal, stored = (rng.uniform(*RANGES[name]) for name in list(RANGES)[4:])
    minutes = STEP_MIN * np.arange(horizon + 1)
    by_air, by_heater = np.exp(-minutes / air_min), np.exp(-minutes / heater_min)
    # The air after a pulse of heat that was in the element, and after a step of the duty, both from rest.
    pulse = heater_min / (heater_min - air_min) * (by_heater - by_air)
    step = 1.0 - (air_min * by_air - heater_min * by_heater) / (air_min - heater_min)
    free = room + rise * (above * by_air + stored * pulse)
    return PlanningProblem(
        free=free[1:],
        heater=_late(rise * np.diff(step), heater_late),
        fan=_late(-fall * np.diff(1.0 - by_air), fan_late),
        reference=np.full(horizon, room + goal * rise),
        heater_weight=weight,
        fan_weight=weight,
        fan_rules=FanRules(on=bool(rng.integers(0, 2))),
    )


def _late(response: Floats, steps: int) -> Floats:
    return np.concatenate([np.zeros(steps), response])[: len(response)]
