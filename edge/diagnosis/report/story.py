"""Contents of a report: the diagnosis, and the series behind its pictures."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnosis_document import DiagnosisDocument

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A run, measured and simulated. Every array is [N], one value a row of `time_s`, NaN where unknown.

    name, role : as in the diagnosis, and `train` or `test`
    measured, before, after : air temperature, by the sensor and in free runs of the twin [°C]
    duty, fan : 0..1, held from a row to the next;  ambient : room temperature [°C]
    residual_heat_... : measured minus the twin's, as a heat flow into the air [W]
    innovations_... : measured minus predicted from the row before, in K or in their standard deviations
    What is infinite becomes NaN, and a series of nothing but NaN None.
    Errors : DataError where an array is of another length
    """

    name: str
    role: str
    time_s: Floats
    measured: Floats | None = None
    before: Floats | None = None
    after: Floats | None = None
    duty: Floats | None = None
    fan: Floats | None = None
    ambient: Floats | None = None
    residual_heat_before_w: Floats | None = None
    residual_heat_after_w: Floats | None = None
    innovations_before: Floats | None = None
    innovations_after: Floats | None = None

    def __post_init__(self) -> None:
        for item in fields(self)[3:]:
            values = getattr(self, item.name)
            if values is None:
                continue
            if np.shape(values) != np.shape(self.time_s):
                shapes = f"shape {np.shape(values)} for times of shape {np.shape(self.time_s)}"
                raise DataError(f"report: {self.name}: {item.name}: {shapes}")
            known = np.isfinite(values)
            object.__setattr__(self, item.name, np.where(known, values, np.nan) if known.any() else None)

    def residual(self, when: str) -> Floats | None:
        """Measured minus the free run `before` or `after` [K], NaN where not known; None without one."""
        predicted = self.before if when == "before" else self.after
        if self.measured is None or predicted is None:
            return None
        return self.measured - predicted

    @property
    def scored(self) -> bool:
        """True if there are measurements beyond the first rows of a forecast."""
        return self.measured is not None and bool(np.isfinite(self.measured).mean() > 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Story:
    """document : a diagnosis as its schema says;  traces : runs to draw, in the order to draw them"""

    document: DiagnosisDocument
    traces: tuple[Trace, ...] = ()


def worst_stretch(trace: Trace, length_s: float) -> Trace:
    """Return the part of that length with the largest free-run error before, all of a shorter run."""
    if trace.time_s[-1] - trace.time_s[0] <= length_s:
        return trace
    residual = trace.residual("before")
    squares = np.zeros(len(trace.time_s)) if residual is None else np.nan_to_num(residual**2)
    ends = np.searchsorted(trace.time_s, trace.time_s + length_s, side="right")
    total = np.append(0.0, np.cumsum(squares))
    whole = trace.time_s + length_s <= trace.time_s[-1]  # begins from which there is so much
    begin = int(np.argmax(np.where(whole, total[ends] - total[:-1], -1.0)))
    part = slice(begin, int(ends[begin]))
    series: list[Any] = [getattr(trace, item.name) for item in fields(trace)[2:]]
    cut: list[Any] = [None if one is None else one[part] for one in series]
    return Trace(trace.name, trace.role, *cut)
