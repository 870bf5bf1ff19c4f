"""Hourly control costs of a rig, from the samples of its ticks in VictoriaMetrics."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from statistics import fmean

from edge.lab.cost import step_cost
from fleet.numbers.series import PREFIX, any_of
from fleet.numbers.victoria import Numbers
from fleet.rollout.judge import HOUR_S, HourCost
from fleet.settings import NumbersSettings

Costs = Callable[[str, float, float], list[HourCost]]  # of a rig, from and until a time [s since 1970]
QUANTITIES = ("temp_air_c", "reference_c", "sent_heater_duty", "sent_fan_share")
AIR, REFERENCE, DUTY, FAN = (PREFIX + quantity for quantity in QUANTITIES)
STEP_MAX_S = 600.0  # between two ticks that are neighbours
COVERED_LEAST = 0.75  # of an hour
MS = 1000

Samples = Mapping[str, Mapping[int, float]]  # name of a series -> time [ms] -> value


def costs_from(settings: NumbersSettings) -> Costs:
    """Return the reader of a fleet's numbers. The reader raises NumbersError where they cannot be read."""
    numbers = Numbers(settings)

    def costs(rig: str, since_utc: float, until_utc: float) -> list[HourCost]:
        # The step that begins before `until_utc` ends at the tick after it.
        samples = {
            series.labels["__name__"]: {
                round(MS * utc): value for utc, value in zip(series.utc, series.values, strict=True)
            }
            for series in numbers.series(any_of(QUANTITIES, rig), since_utc, until_utc + STEP_MAX_S)
        }
        return [hour for hour in hourly(samples) if since_utc <= hour.begin_utc < until_utc]

    return costs


def hourly(samples: Samples) -> list[HourCost]:
    """Return the mean cost of a step in each hour that is covered by steps, the oldest first."""
    found: dict[float, list[tuple[float, float]]] = defaultdict(list)
    for begin_s, length_s, cost in _steps(samples):
        found[begin_s // HOUR_S * HOUR_S].append((length_s, cost))
    return [
        HourCost(begin, fmean(cost for _, cost in steps))
        for begin, steps in sorted(found.items())
        if sum(length_s for length_s, _ in steps) >= COVERED_LEAST * HOUR_S
    ]


def _steps(samples: Samples) -> Iterator[tuple[float, float, float]]:
    """Yield begin [s], length [s] and cost of each step: its error is that of the air at the next tick."""
    air, reference, duty, fan = (samples.get(name, {}) for name in (AIR, REFERENCE, DUTY, FAN))
    times = sorted(reference.keys() & duty.keys() & fan.keys())
    for at, after in pairwise(times):
        if after in air and after - at <= MS * STEP_MAX_S:
            yield at / MS, (after - at) / MS, step_cost(air[after] - reference[at], duty[at], fan[at])
