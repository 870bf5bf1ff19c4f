"""Terms that an unknown heat may be proportional to: signals, bent or slow ones, and products of two."""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residuals import Residuals
from edge.diagnosis.locate.rows import DAY_S, HOUR_S
from edge.twin.effects.signal import vapour_deficit_kpa

Floats = NDArray[np.float64]
SLOW_S = 900.0  # after which a slow signal has followed by 63 %
FEWEST_HOURS, FEWEST_DAYS = 6.0, 1.5  # recorded, before the hour or the day may matter

Heat = Callable[[Residuals], Floats]


class FormulaTerm(NamedTuple):
    """A formula, the signals in it by their public names, and its value in each step, [N]."""

    formula: str
    signals: tuple[str, ...]
    value: Heat

    def times(self, other: "FormulaTerm") -> "FormulaTerm":
        """Return the product of two terms."""
        signals = tuple(dict.fromkeys(self.signals + other.signals))
        return FormulaTerm(
            f"{self.formula} {other.formula}", signals, lambda run: self.value(run) * other.value(run)
        )


DUTY, FAN, AIR, ROOM = "heater_duty", "fan_on", "temp_air", "temp_ambient"
LIGHT, HUMIDITY, TIME = "light", "rel_humidity", "time"
_DUTY = FormulaTerm("u", (DUTY,), lambda run: run.duty)
_FAN = FormulaTerm("u_f", (FAN,), lambda run: run.fan)
_STILL = FormulaTerm("(1 - u_f)", (FAN,), lambda run: 1.0 - run.fan)
_EXCESS = FormulaTerm("(T - T_amb)", (AIR, ROOM), lambda run: run.excess_k)
_AIR = FormulaTerm("T", (AIR,), lambda run: run.air_c)
_LIGHT = FormulaTerm("L", (LIGHT,), lambda run: _known_or_zero(run.light))
_HUMIDITY = FormulaTerm("RH", (HUMIDITY,), lambda run: _known_or_zero(run.rel_humidity) / 100.0)
_DEFICIT = FormulaTerm(
    "VPD", (HUMIDITY, AIR), lambda run: vapour_deficit_kpa(run.air_c, _known_or_zero(run.rel_humidity))
)
ALONE = (
    _DUTY,
    FormulaTerm("u^2", (DUTY,), lambda run: run.duty**2),
    FormulaTerm("slow(u)", (DUTY,), lambda run: _slow(run.duty, run.step_s)),
    _FAN,
    FormulaTerm("slow(u_f)", (FAN,), lambda run: _slow(run.fan, run.step_s)),
    _EXCESS,
    FormulaTerm("(T - T_amb)^2", (AIR, ROOM), lambda run: run.excess_k * np.abs(run.excess_k)),
    FormulaTerm("slow(T)", (AIR,), lambda run: _slow(run.air_c, run.step_s)),
    _AIR,
    FormulaTerm("T_amb", (ROOM,), lambda run: run.ambient),
)


def library(runs: Sequence[Residuals]) -> list[FormulaTerm]:
    """Return the terms that these runs have the columns and the duration for."""
    lit = [_LIGHT] if all(run.light is not None for run in runs) else []
    humid = [_HUMIDITY, _DEFICIT] if all(run.rel_humidity is not None for run in runs) else []
    times = _times(runs)
    factors = [_DUTY, _FAN, _STILL, _EXCESS, _AIR, *lit, *humid, *times]
    products = [a.times(b) for a, b in combinations(factors, 2) if not set(a.signals) & set(b.signals)]
    return [*ALONE, *lit, *humid, *times, *products]


def _times(runs: Sequence[Residuals]) -> list[FormulaTerm]:
    found = [FormulaTerm("t", (TIME,), lambda run: run.time_s / HOUR_S)]
    starts = [run.start_utc for run in runs]
    if any(start is None for start in starts):
        return found
    first = min(start for start in starts if start is not None)
    spans = [(_begin(run) + run.time_s[-1]) for run in runs if len(run.time_s)]
    hours = {int(h) for run in runs for h in ((_begin(run) + run.time_s) % DAY_S) // HOUR_S}
    if len(hours) >= FEWEST_HOURS:
        found.append(FormulaTerm("sin(2 pi h / 24)", (TIME,), lambda run: np.sin(_angle(run))))
        found.append(FormulaTerm("cos(2 pi h / 24)", (TIME,), lambda run: np.cos(_angle(run))))
    if spans and max(spans) - first >= FEWEST_DAYS * DAY_S:
        found.append(FormulaTerm("day", (TIME,), lambda run: (_begin(run) + run.time_s - first) / DAY_S))
    return found


def _angle(run: Residuals) -> Floats:
    return np.asarray(2.0 * np.pi * ((_begin(run) + run.time_s) % DAY_S) / DAY_S)


def _begin(run: Residuals) -> float:
    return 0.0 if run.start_utc is None else run.start_utc


def _known_or_zero(column: Floats | None) -> Floats:
    if column is None:
        raise ValueError("a term of a column that the run does not have")
    return column


def _slow(values: Floats, step_s: float) -> Floats:
    """First-order lag, at rest before the first row."""
    keeps, slow = float(np.exp(-step_s / SLOW_S)), 0.0
    found = np.empty(len(values))
    for k, value in enumerate(values.tolist()):
        slow = keeps * (slow if k else value) + (1.0 - keeps) * value
        found[k] = slow
    return found
