"""Disagreement of the twin as given: its regimes, the doors that were found, and its innovations."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.diagnosis_document import EventEntry, RegimeEntry
from edge.diagnosis.locate.regimes import regimes
from edge.diagnosis.locate.residuals import Residuals, residuals_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """Places of the disagreement, in the form of diagnosis.json.

    innovations : of each run in standard deviations, a value a step, NaN where nothing was measured; empty
        where the twin is too far off
    """

    regimes: list[RegimeEntry] = field(default_factory=list)
    events: list[EventEntry] = field(default_factory=list)
    innovations: Mapping[str, Floats] = field(default_factory=dict)


def locate(found: Diagnosis) -> Location:
    """Return where the twin as given disagrees with the training runs."""
    every = _residuals(found)
    events: list[EventEntry] = [
        {"run": door.run, "from_s": door.from_s, "to_s": door.to_s, "kind": "door", "heat_w": door.heat_w}
        for door in found.doors
    ]
    return Location(regimes(every), events, {item.name: item.innovation for item in every})


def _residuals(found: Diagnosis) -> list[Residuals]:
    """Return those of each run; none of a twin that is so far off that its filter has no sense."""
    known, side = found.inputs, found.before
    runs = known.with_rooms(side.fit.starts)
    try:
        every = residuals_of(side.fit.file.twin(), runs, known.names, known.noise_k)
    except (DataError, np.linalg.LinAlgError):
        return []
    return [item for item in every if np.isfinite(item.heat_w).any()]
