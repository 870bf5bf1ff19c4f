"""Variables that the residual heat may depend on, and the one that explains most."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.report.story import Floats, Trace

BINS = 9
SWITCH_MIN = 45.0  # longest time since a change of the duty that is looked at [min]
STEP = 0.04  # smallest change of the duty that is one; the heater moves in steps of 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Variable:
    """A quantity, and two groups of its rows. x : [N], NaN where not defined;  group : [N], 0 or 1"""

    key: str
    label: str
    x: Floats
    group: NDArray[np.intp]
    groups: tuple[str, str]


def variables(traces: Sequence[Trace]) -> list[Variable]:
    """All that are known of these runs, their rows one after another; those named like a signal first.

    The heat of a row was missing since the row before: it goes with the inputs that were held from there.
    """
    found = []
    fan = _series(traces, lambda one: _last(one.fan))
    group = (np.nan_to_num(fan, nan=0.0) > 0.5).astype(np.intp)
    for key, label, of in _SIGNALS:
        x = _series(traces, of)
        if np.isfinite(x).any():
            found.append(Variable(key, label, x, group, ("fan off", "fan on")))
    since, rising = (np.concatenate(parts) for parts in zip(*map(_since_change, traces), strict=True))
    if np.isfinite(since).any():
        groups = ("after a step down", "after a step up")
        found.append(
            Variable("switch", "time since the duty changed [min]", since, rising.astype(np.intp), groups)
        )
    return found


def explained_share(variable: Variable, heat: Floats) -> float:
    """Share of the variance of `heat` [N] that means over bins and groups explain, less what chance would."""
    cells = [heat[rows] for rows, _ in bins(variable, heat)]
    rows = sum(map(len, cells))
    if rows < 4 * max(len(cells), 1):
        return 0.0
    values = np.concatenate(cells)
    total = float(((values - values.mean()) ** 2).sum())
    within = sum(float(((cell - cell.mean()) ** 2).sum()) for cell in cells)
    return 0.0 if total == 0.0 else 1.0 - (within / (rows - len(cells))) / (total / (rows - 1))


def bins(variable: Variable, heat: Floats) -> list[tuple[NDArray[np.intp], int]]:
    """Rows of each cell with its group: bins of about as many rows each, without those of fewer than 3."""
    known = np.isfinite(variable.x) & np.isfinite(heat)
    if not known.any():
        return []
    edges = np.unique(np.quantile(variable.x[known], np.linspace(0.0, 1.0, BINS + 1)))
    place = np.clip(np.searchsorted(edges, variable.x, side="right") - 1, 0, max(len(edges) - 2, 0))
    cells = [
        (np.flatnonzero(known & (place == number) & (variable.group == group)), group)
        for group in (0, 1)
        for number in range(max(len(edges) - 1, 1))
    ]
    return [(rows, group) for rows, group in cells if len(rows) >= 3]


def _series(traces: Sequence[Trace], of: Callable[[Trace], Floats | None]) -> Floats:
    parts = [of(one) for one in traces]
    blanks = [np.full(len(one.time_s), np.nan) for one in traces]
    return np.concatenate([b if p is None else p for p, b in zip(parts, blanks, strict=True)])


def _last(values: Floats | None) -> Floats | None:
    """Return the values of the row before."""
    return None if values is None else np.append(np.nan, values[:-1])


def _difference(trace: Trace) -> Floats | None:
    known = trace.measured is not None and trace.ambient is not None
    return trace.measured - trace.ambient if known else None  # type: ignore[operator]  # both are known


def _since_change(trace: Trace) -> tuple[Floats, Floats]:
    """Minutes since the duty last changed, NaN before its first change and long after; whether it rose."""
    since, rising = np.full(len(trace.time_s), np.nan), np.zeros(len(trace.time_s))
    if trace.duty is None:
        return since, rising
    changes = np.flatnonzero(np.abs(np.diff(trace.duty)) > STEP) + 1
    last = np.searchsorted(changes, np.arange(len(since)), side="right") - 1
    rows = np.flatnonzero(last >= 0)
    begun = changes[last[rows]]
    since[rows] = (trace.time_s[rows] - trace.time_s[begun]) / 60.0
    rising[rows] = trace.duty[begun] > trace.duty[begun - 1]
    since[(since == 0.0) | (since > SWITCH_MIN)] = np.nan  # at 0 the change has not acted yet
    return since, rising


_SIGNALS: tuple[tuple[str, str, Callable[[Trace], Floats | None]], ...] = (
    ("difference", "air − room [K]", _difference),
    ("heater_duty", "heater duty [0..1]", lambda one: _last(one.duty)),
    ("temp_air", "air temperature [°C]", lambda one: one.measured),
    ("temp_ambient", "room temperature [°C]", lambda one: one.ambient),
    ("time", "time in the run [min]", lambda one: one.time_s / 60.0),
)
