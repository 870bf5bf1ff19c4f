"""Contents of a report: the diagnosis, and the series behind its pictures."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.diagnosis_document import DiagnosisDocument, Role

Floats = NDArray[np.float64]
SERIES = ("measured", "before", "after", "innovations")


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A run, measured and simulated. Every array is [N], one value a row of `time_s`, NaN where unknown.

    name, role : as in the diagnosis, and `train` or `test`
    measured, before, after : air temperature, by the sensor and in free runs of the twin [°C]
    innovations : measured minus predicted from the row before by the twin as given, in standard deviations
    inputs : by signal, held from a row to the next: `heater_duty`, `fan_on`, `temp_ambient`, `light`, ...
    What is infinite becomes NaN, and a series of nothing but NaN None (an input is left out).
    """

    name: str
    role: Role
    time_s: Floats
    measured: Floats | None = None
    before: Floats | None = None
    after: Floats | None = None
    innovations: Floats | None = None
    inputs: Mapping[str, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in SERIES:
            object.__setattr__(self, key, _finite(getattr(self, key)))
        known = {key: _finite(values) for key, values in self.inputs.items()}
        object.__setattr__(self, "inputs", {key: one for key, one in known.items() if one is not None})

    def residual(self, when: str) -> Floats | None:
        """Measured minus the free run `before` or `after` [K], NaN where not known; None without one."""
        predicted = self.before if when == "before" else self.after
        if self.measured is None or predicted is None:
            return None
        return self.measured - predicted

    def rmse_k(self) -> float:
        """Return the error of the free run before, 0 where it is not known."""
        residual = self.residual("before")
        known = residual[np.isfinite(residual)] if residual is not None else np.empty(0)
        return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0

    @property
    def scored(self) -> bool:
        """True if there are measurements beyond the first rows of a forecast."""
        return self.measured is not None and bool(np.isfinite(self.measured).mean() > 0.5)


def _finite(values: Floats | None) -> Floats | None:
    if values is None or not (known := np.isfinite(values)).any():
        return None
    return np.where(known, values, np.nan)


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
    series = [None if (one := getattr(trace, key)) is None else one[part] for key in SERIES]
    measured, before, after, innovations = series
    inputs = {key: values[part] for key, values in trace.inputs.items()}
    return Trace(trace.name, trace.role, trace.time_s[part], measured, before, after, innovations, inputs)
