"""One structure for all boxes of a kind, fitted to what each of them recorded.

Diagnoses of boxes that are built alike do not name the same. One has soil where the next has a wall, and what
one calls a constant heat another puts into its loss, so their values are not of the same things. Each
structure that a box of the kind has told is therefore fitted to the recordings of all of them, and some that
join what two have told or have what no diagnosis names. The kind's is one in which an hour of each box, with
what the others tell, foretells the rest of it (`rehearsal`): it need not be the one that follows recordings
best.
"""

from collections import Counter
from collections.abc import Container, Mapping, Sequence
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
from fleet.priors.fleet_prior import LEAST_MISS_K, MOST_MISS_K, OF_BOX, BoxSheet, told_effects
from fleet.priors.rehearsal import Rehearsal

Floats = NDArray[np.float64]
Structure = tuple[str, ...]
Fits = Mapping[tuple[str, Structure], TwinFile]
Rehearsals = Mapping[tuple[str, Structure], Rehearsal]  # by rig and structure
Misses = dict[Structure, Floats]  # of each box [K]
BODY, SLOW_BODY = "soil_mass", "slow_mass"
CONVECTION = "natural_convection"
ANY_HEAT = "constant_heat"  # of where a box stands: the sun in the mean, what stands beside it
MOST_TOLD, MOST_JOINED = 6, 3  # structures of a kind, as each is fitted to every box
# WORTH was found on 507, AS_GOOD on 507 to 510, SEEN on 514, 515 and 601, all development designs then
# (docs/measured/fleet.md).
WORTH = 0.8  # times what is missed without a heat or effects more: boxes that miss less with them have them
LEAST_BOXES = 2  # of a kind, to compare; all of a smaller one
FAR = 3.0  # times the least miss of a box
SEEN = 3.0  # boxes without a difference, as if they had been rehearsed too: a few tell little of a loss
AS_GOOD = 1.1  # times the least miss, mean over boxes: a simpler structure is taken


def structures(sheets: Sequence[BoxSheet]) -> dict[str, list[Structure]]:
    """Return the structures to fit, by kind: those told most often, unions of two, one with a slow body.

    Each of them also with natural convection. Of boxes without a kind none.
    """
    found: dict[str, Counter[Structure]] = {}
    for sheet in sheets:
        if sheet.kind:
            found.setdefault(sheet.kind, Counter())[_union(tuple(told_effects(sheet.twin)))] += 1
    return {kind: _to_try(own) for kind, own in found.items()}


def _to_try(told: Counter[Structure]) -> list[Structure]:
    """Return what most have told, what two of these make, one with a slow body, and each with convection.

    One box names what the next one lacks.
    """
    most = [own for own, _ in told.most_common(MOST_TOLD)]
    joined = {_union(a, b) for a, b in combinations(most, 2)} - {*most}
    known = [*most, *sorted(joined, key=lambda own: (len(own), own))[:MOST_JOINED]]
    known += _with_slow_body(known)
    # Air moves along warm walls in every box, though a diagnosis may put that bend into something else.
    return sorted({*known, *(_union(own, (CONVECTION,)) for own in known)})


def _with_slow_body(known: Sequence[Structure]) -> list[Structure]:
    """Return the fullest structure that has a body with a slower one beside it.

    A diagnosis knows two bodies as one. A day after hours of tests tells them apart, and where one has to do
    for both, neither the loss nor what bends is that of the box (docs/measured/fleet.md).
    """
    with_body = [own for own in known if BODY in own]
    return [_union(max(with_body, key=lambda own: (len(own), own)), (SLOW_BODY,))] if with_body else []


def _union(*parts: Structure) -> Structure:
    return tuple(name for name in OF_BOX if any(name in part for part in parts))


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


def choose(sheets: Sequence[BoxSheet], fits: Fits, rehearsed: Rehearsals) -> dict[str, Structure]:
    """Return the structure that serves new boxes of each kind best; nothing of a kind without fits.

    fits, rehearsed : by rig and structure
    """
    found = {}
    for kind, wanted in structures(sheets).items():
        mine = [sheet.rig for sheet in sheets if sheet.kind == kind]
        chosen = _chosen(wanted, mine, fits, rehearsed)
        if chosen is not None:
            found[kind] = chosen
    return found


def loss_shares(
    sheets: Sequence[BoxSheet], chosen: Mapping[str, Structure], rehearsed: Rehearsals
) -> dict[str, float]:
    """Return by kind what the loss over days is of that which an hour tells, drawn towards 1."""
    found = {}
    for kind, own in chosen.items():
        rigs = [sheet.rig for sheet in sheets if sheet.kind == kind and (sheet.rig, own) in rehearsed]
        logs = [np.log(rehearsed[rig, own].loss_share) for rig in rigs] or [0.0]
        found[kind] = float(np.exp(np.median(logs) * len(rigs) / (len(rigs) + SEEN)))  # one rig may lie
    return found


def in_kind_structure(
    sheets: Sequence[BoxSheet], fits: Fits, chosen: Mapping[str, Structure]
) -> list[BoxSheet]:
    """Return the boxes of each kind with their twins in its structure; of a kind without one as they are."""
    found = []
    for kind in sorted({sheet.kind for sheet in sheets}):
        mine = [sheet for sheet in sheets if sheet.kind == kind]
        if kind in chosen:
            names = chosen[kind]
            mine = [
                replace(sheet, twin=fits[sheet.rig, names]) for sheet in mine if (sheet.rig, names) in fits
            ]
        found += mine
    return found


def comparable(
    names: Sequence[Structure], rigs: Sequence[str], known: Container[tuple[str, Structure]]
) -> tuple[list[Structure], list[str]]:
    """Return structures that can be compared, and the boxes that are known in each of them.

    known : of which box and structure something is
    """
    counts = {own: sum((rig, own) in known for rig in rigs) for own in names}
    most = max(counts.values(), default=0)
    # One that hardly any box could be fitted in is in nobody's way.
    good = [own for own, count in counts.items() if count and count >= most / 2]
    return good, [rig for rig in rigs if good and all((rig, own) in known for own in good)]


def _chosen(
    names: Sequence[Structure], rigs: Sequence[str], fits: Fits, rehearsed: Rehearsals
) -> Structure | None:
    """Return what suits a kind; None where too few of its boxes can be compared."""
    least = min(LEAST_BOXES, len(rigs))
    names, fitted = comparable(names, rigs, fits)
    if len(fitted) < least:
        return None
    followed = {own: _misses_k([fits[rig, own] for rig in fitted]) for own in names}
    tried, new = comparable(names, fitted, rehearsed)
    if len(new) < least:
        return _best(followed, followed)
    return _best({own: np.array([rehearsed[rig, own].missed_k for rig in new]) for own in tried}, followed)


def _best(missed: Misses, followed: Misses) -> Structure:
    """Return a structure that misses least.

    Of those that miss alike the simplest is taken, unless all boxes are followed much better by another:
    rehearsals by two or three others leave more to chance than fits of days.

    followed : what it was fitted to
    """
    beside = _beside(missed)
    good = _near(beside, AS_GOOD)
    close = _near(_beside({own: followed[own] for own in good}), 1.0 / WORTH)
    return min(close, key=lambda own: (len(own), beside[own]))


def _beside(missed: Misses) -> dict[Structure, float]:
    """Return the logarithm of each miss over the least of its box, mean over boxes."""
    least = np.clip(np.min([*missed.values()], axis=0), LEAST_MISS_K, MOST_MISS_K)
    # No box counts beyond that: one whose readings are made up may follow its own structure exactly.
    return {own: float(np.log(np.clip(one / least, 1.0, FAR)).mean()) for own, one in missed.items()}


def _near(beside: Mapping[Structure, float], most: float) -> list[Structure]:
    """Return what is no more than `most` times the least."""
    return [own for own, one in beside.items() if one <= min(beside.values()) + np.log(most)]


def _misses_k(twins: Sequence[TwinFile]) -> Floats:
    return np.array([_miss_k(twin, "train") for twin in twins])
