"""Hourly control costs of a rig, from the samples of its ticks in VictoriaMetrics."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from itertools import pairwise
from statistics import fmean
from typing import Any
from urllib.parse import urlencode, urlsplit

from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.lab.cost import step_cost
from fleet.rollout.judge import HOUR_S, HourCost
from fleet.settings import NumbersSettings

Costs = Callable[[str, float, float], list[HourCost]]  # of a rig, from and until a time [s since 1970]
AIR, REFERENCE, DUTY, FAN = (
    f"greenhouse_{name}" for name in ("temp_air_c", "reference_c", "sent_heater_duty", "sent_fan_share")
)
TIMEOUT_S = 30.0
STEP_MAX_S = 600.0  # between two ticks that are neighbours
COVERED_LEAST = 0.75  # of an hour
MS = 1000

Samples = Mapping[str, Mapping[int, float]]  # name of a series -> time [ms] -> value


def costs_from(settings: NumbersSettings) -> Costs:
    """Return the reader of a fleet's numbers. The reader raises DataError where they cannot be read."""

    def costs(rig: str, since_utc: float, until_utc: float) -> list[HourCost]:
        # The step that begins before `until_utc` ends at the tick after it.
        samples = _read(settings.url, rig, since_utc, until_utc + STEP_MAX_S)
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


def _numbers(row: Mapping[str, Any]) -> Iterator[tuple[int, float]]:
    """Yield time [ms] and value of each sample; a null is not a number."""
    for at, value in zip(row["timestamps"], row["values"], strict=True):
        if value is not None:
            yield int(at), float(value)


def _read(url: str, rig: str, since_utc: float, until_utc: float) -> Samples:
    parts = urlsplit(url)
    selector = f'{{__name__=~"{"|".join((AIR, REFERENCE, DUTY, FAN))}",rig={json.dumps(rig)}}}'
    asked = urlencode({"match[]": selector, "start": since_utc, "end": until_utc})
    kind = HTTPSConnection if parts.scheme == "https" else HTTPConnection
    try:
        line = kind(parts.hostname or "", parts.port, timeout=TIMEOUT_S)
        try:
            line.request("GET", f"{parts.path.rstrip('/')}/api/v1/export?{asked}")
            answer = line.getresponse()
            content = answer.read()
        finally:
            line.close()
        if answer.status != 200:
            said = plain(content[:200].decode(errors="replace"))
            raise DataError(f"numbers.url: {url}: answers {answer.status}: {said}")
        series = [json.loads(row) for row in content.splitlines()]
        return {row["metric"]["__name__"]: dict(_numbers(row)) for row in series}
    except (OSError, HTTPException, ValueError, KeyError, TypeError) as error:
        raise DataError(f"numbers.url: {url}: {error or type(error).__name__}") from error
