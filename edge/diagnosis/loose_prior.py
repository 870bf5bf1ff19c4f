"""A prior that lets a value go that is far from it: Student's t as a scale mixture of normals.

A fit under normal priors is drawn back by a value that is far from its own, and moves others in its place: a
box whose lid stands open would get a lag in place of a loss. So spreads are widened by what a fit to free
runs says, and the fit renewed (Lange, Little & Taylor 1989, JASA 84).
"""

from dataclasses import replace

import numpy as np

from edge.diagnosis.free_fit import fit_values
from edge.diagnosis.noise_levels import first_levels
from edge.diagnosis.prepare import PreparedRuns
from edge.diagnosis.side_by_side import SideBySide
from edge.twin.twin_file import Place, TwinFile

FREEDOM = 4.0  # as of boxes about their kind (fleet/priors/population.py)
ROUNDS = 4


def loosen(prepared: PreparedRuns) -> TwinFile:
    """Return the twin with wider spreads for the values that the runs move far; the values stay."""
    file, spreads = prepared.file, dict[Place, float]()
    rooms = [term for term in prepared.terms if term.of_room]
    noise_k = first_levels(file, prepared.runs).sensor_k
    given = {place: value.rel_sd for place, value in file.values().items()}
    for _ in range(ROUNDS):
        loose = _with_spreads(file, spreads)
        (found,) = fit_values([loose], rooms, prepared.runs, noise_k, SideBySide())
        for item, x in zip(found.free, found.coordinates, strict=True):
            if (rel_sd := given[item.place]) is not None:
                # The spread of its coordinate is the prior's, but for what the last round has widened it by.
                widened = (spreads.get(item.place) or rel_sd) / rel_sd
                squares = ((x - item.mean) / item.sd * widened) ** 2
                spreads[item.place] = rel_sd * max(1.0, float(np.sqrt((FREEDOM + squares) / (FREEDOM + 1.0))))
    return _with_spreads(file, spreads)


def _with_spreads(file: TwinFile, spreads: dict[Place, float]) -> TwinFile:
    values = file.values()
    return file.with_values(
        {place: replace(values[place], rel_sd=float(f"{rel_sd:.3g}")) for place, rel_sd in spreads.items()}
    )
