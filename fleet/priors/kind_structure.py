"""One structure for all boxes of a kind, fitted to what each of them recorded.

Diagnoses of boxes that are built alike do not name the same. One has soil where the next has a wall, and what
one calls a constant heat another puts into its loss, so their values are not of the same things. Each
structure that a box of the kind has told is therefore fitted to the recordings of all of them, and some that
join what two have told. The kind's is the simplest of those that follow all boxes and let expect of each what
the others have: with values that are far apart, or a heat that each box needs, a new box is told nothing.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.baselines import bare
from edge.diagnosis.diagnose import fitted_twin
from edge.diagnosis.free_fit import fit_values, rms_k
from edge.diagnosis.gap import errors, forecast
from edge.diagnosis.noise_levels import first_levels
from edge.diagnosis.prepare import prepare, with_rooms
from edge.diagnosis.runs import DiagnosisRuns
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.unknowns import with_usual
from edge.twin.provenance import provenance_numbers
from edge.twin.twin_file import TwinFile
from fleet.priors.fleet_prior import LEAST_MISS_K, OF_BOX, BoxSheet, fit_prior, told_effects
from fleet.priors.shared_structure import answer

Floats = NDArray[np.float64]
Structure = tuple[str, ...]
Fits = Mapping[tuple[str, Structure], TwinFile]
ANY_HEAT = "constant_heat"  # of where a box stands: the sun in the mean, what stands beside it
MOST_TOLD, MOST_JOINED = 6, 3  # structures of a kind, as each is fitted to every box
# WORTH and AS_GOOD were found on a development design, 507, LEFT on three more (docs/measured/fleet.md).
WORTH = 0.8  # times the miss without that heat: a box that misses less with it has it
LEAST_BOXES = 2  # of a kind, to compare; all of a smaller one
FAR = 3.0  # times the least miss of a box
LEFT = 0.3  # share of what a box differs by from what its kind lets expect, after an hour of its own
AS_GOOD = 1.05  # times the least miss, mean over boxes: a simpler structure is taken


def structures(sheets: Sequence[BoxSheet]) -> dict[str, list[Structure]]:
    """Return the structures to fit, by kind: those told most often and unions of two, the simplest ones.

    Of boxes without a kind none.
    """
    found: dict[str, Counter[Structure]] = {}
    for sheet in sheets:
        if sheet.kind:
            told = told_effects(sheet.twin)
            found.setdefault(sheet.kind, Counter())[tuple(name for name in OF_BOX if name in told)] += 1
    return {kind: _with_joined(own) for kind, own in found.items()}


def _with_joined(told: Counter[Structure]) -> list[Structure]:
    """Return what most have told, and what two of these make: one box names what the next one lacks."""
    most = [own for own, _ in told.most_common(MOST_TOLD)]
    joined = {tuple(name for name in OF_BOX if name in {*a, *b}) for a, b in combinations(most, 2)} - {*most}
    return sorted([*most, *sorted(joined, key=lambda own: (len(own), own))[:MOST_JOINED]])


def fit_structure(box: TwinFile, data: DiagnosisRuns, names: Structure) -> TwinFile:
    """Return a box's twin with these effects; its provenance tells what it misses by.

    box : a twin of it, for its description; data : what it recorded; names : beside what every twin has
    Errors : DataError for runs that nothing can be fitted to
    """
    file = bare(box)
    for name in names:
        file = with_usual(file, name)
    plain, heated = (_fit(own, data) for own in (file, with_usual(file, ANY_HEAT)))
    return heated if _miss_k(heated, "train") < WORTH * _miss_k(plain, "train") else plain


def _fit(file: TwinFile, data: DiagnosisRuns) -> TwinFile:
    prepared = prepare(file, data)
    rooms = tuple(term for term in prepared.terms if term.of_room)
    noise_k = first_levels(prepared.file, prepared.runs).sensor_k
    (found,) = fit_values([prepared.file], rooms, prepared.runs, noise_k, SideBySide())
    twin, known = fitted_twin(found), with_rooms(prepared, found.sizes)
    ahead = [forecast(twin.twin(), run, known.room_of(run)) for run in data.test]
    missed = {"train": {"rmse_k": rms_k(found, prepared.runs)}, "test": errors(ahead)}
    after = {part: {"rmse_k": own["rmse_k"]} for part, own in missed.items() if own}
    return replace(twin, provenance={**twin.provenance, "after": after})


def _miss_k(twin: TwinFile, part: str) -> float:
    return max(provenance_numbers(twin, "after", part, "rmse_k"), default=np.inf)


def in_kind_structure(sheets: Sequence[BoxSheet], fits: Fits) -> list[BoxSheet]:
    """Return the boxes of each kind with their twins in its structure; of a kind without fits as they are.

    fits : by rig and structure
    """
    found, wanted = [], structures(sheets)
    for kind in sorted({sheet.kind for sheet in sheets}):
        mine = [sheet for sheet in sheets if sheet.kind == kind]
        chosen = _chosen(wanted.get(kind, []), [sheet.rig for sheet in mine], fits)
        if chosen is not None:
            mine = [
                replace(sheet, twin=fits[sheet.rig, chosen]) for sheet in mine if (sheet.rig, chosen) in fits
            ]
        found += mine
    return found


def _chosen(names: Sequence[Structure], rigs: Sequence[str], fits: Fits) -> Structure | None:
    """Return the structure of a kind; None where too few of its boxes can be compared."""
    known = {own: [rig for rig in rigs if (rig, own) in fits] for own in names}
    most = max(map(len, known.values()), default=0)
    # One that hardly any box could be fitted in is in nobody's way.
    names = [own for own, fitted in known.items() if fitted and len(fitted) >= most / 2]
    compared = [rig for rig in rigs if names and all((rig, own) in fits for own in names)]
    return _best(names, compared, fits) if len(compared) >= min(LEAST_BOXES, len(rigs)) else None


def _best(names: Sequence[Structure], rigs: Sequence[str], fits: Fits) -> Structure:
    missed = {own: _to_miss_k([fits[rig, own] for rig in rigs]) for own in names}
    least = np.maximum(np.min([*missed.values()], axis=0), LEAST_MISS_K)
    # No box counts beyond that: one whose readings are made up may follow its own structure exactly.
    beside = {own: np.log(np.clip(one / least, 1.0, FAR)).mean() for own, one in missed.items()}
    good = [own for own in names if beside[own] <= min(beside.values()) + np.log(AS_GOOD)]
    return min(good, key=lambda own: (len(own), beside[own]))


def _to_miss_k(twins: Sequence[TwinFile]) -> Floats:
    """Return what each box would miss by if it were new: as its fit does, and as it is unlike the others."""
    return np.hypot([_miss_k(twin, "train") for twin in twins], LEFT * _unlike_k(twins))


def _unlike_k(twins: Sequence[TwinFile]) -> Floats:
    """How far the answer of each is from what the others let expect, RMS, [n]; 0 for one alone [K].

    A heat of its place counts as far as it goes: a new box does not have it from its kind.
    """
    if len(twins) < 2:
        return np.zeros(len(twins))
    sheets = [BoxSheet(str(i), "one", twin) for i, twin in enumerate(twins)]
    expected = [
        fit_prior([other for other in sheets if other is not sheet]).start(bare(sheet.twin), sheet.kind)
        for sheet in sheets
    ]
    apart = [answer(twin, ()).temp - answer(own, ()).temp for twin, own in zip(twins, expected, strict=True)]
    return np.array([np.nan_to_num(np.sqrt(np.mean(off**2)), nan=np.inf) for off in apart])
