"""Which names stand: each must explain rows that no fit saw, predict them, and have a value that can be.

Held-out evidence is an e-value (Vovk & Wang 2021, Annals of Statistics 49): the likelihood ratio of rows that
the fit did not see, tempered by how far its errors go together in time, which the noise model may not know.
Names pass by e-BH (Wang & Ramdas 2022, JRSS B 84), which bounds the false discovery rate however they depend.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.candidates import Names, ScoredSet
from edge.diagnosis.free_fit import APART_SDS, again, folds, halves, left_out_nats, row_nats, together
from edge.diagnosis.handover import NO_WORSE, Comparison, impossible
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.verdict import LIKELY, evidence, probability
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
FALSE_SHARE = 0.05  # of names, that may be false
HALVES_APART = 0.5  # of a coordinate, for two halves to contradict each other: a factor of 1.6
HALF = 0.5  # of the error, that a name must take away to be thought of, and to stand, on that alone
AGAINST_NATS = 3.0  # by which a half may be against a name


@dataclass(frozen=True, slots=True)
class NameEvidence:
    """Evidence for a name, and against it.

    gain_nats : of rows that were left out, and of what the twin file declares as known
    tempered_nats : the same, errors that go together counted once
    against : sentences, none where it stands
    with_k, without_k, noise_k : errors of free runs over left-out rows, and of a reading
    """

    name: str
    gain_nats: float
    tempered_nats: float
    against: tuple[str, ...]
    with_k: float
    without_k: float
    noise_k: float

    @property
    def probability(self) -> float:
        """That the name is right, or one of those that can't be told from it."""
        return probability(evidence(self.tempered_nats, self.with_k, self.without_k))


def evidence_of(
    whole: ScoredSet, without: Mapping[str, ScoredSet], compared: Comparison, candidates: int
) -> dict[str, NameEvidence]:
    """Each name of a set. without : the set less each name; candidates : how many were tried for one place"""
    runs, step_s, shared = compared.inputs.runs, compared.inputs.file.sample_s, compared.pool
    fits = [whole.fit, *(item.fit for item in without.values())]
    told = left_out_nats(fits, folds(runs), runs, shared)
    # Errors that go together in time say the same thing several times: they count once.
    temper = 1.0 / together(whole.fit.innovations, runs.measured, compared.inputs.file)
    gains = {name: told[0] - own for name, own in zip(without, told[1:], strict=True)}
    known = {name: _known_before(whole, item, runs) for name, item in without.items()}
    tempered = {name: temper * float(gain.sum()) + known[name] for name, gain in gains.items()}
    passed = discover(tempered, candidates)
    half = halves(runs)
    two = [again([whole.fit], replace(runs, left_out=half == 1 - i), shared)[0] for i in range(2)]
    found = {}
    for name, gain in gains.items():
        proven = name in passed or is_proven(whole.added, name, compared)
        against = [] if proven else ["rows that were left out do not prove it"]
        against += _predicting(name, whole.added, compared)
        against += impossible(name, compared.trials[whole.added].fit, runs, step_s)
        against += [] if is_proven(whole.added, name, compared) else _worse_half(gain, half)
        against += _apart_halves(name, two)
        less, own = (compared.trials[key].rmse_k for key in (whole.added - {name}, whole.added))
        item = NameEvidence(
            name,
            float(gain.sum()) + known[name],
            tempered[name],
            tuple(against),
            own,
            less,
            compared.noise_k,
        )
        if item.probability < LIKELY and not against:
            item = replace(
                item, against=(f"it is right in {100.0 * item.probability:.0f} of 100 such cases",)
            )
        found[name] = item
    return found


def is_proven(names: Names, name: str, compared: Comparison) -> bool:
    """Return whether free runs miss left-out rows by much less with a name, in every part of the runs."""
    own, less = compared.trials[names], compared.trials[names - {name}]
    return own.rmse_k < HALF * less.rmse_k and compared.is_better_throughout(own, less)


def _known_before(whole: ScoredSet, less: ScoredSet, runs: RunBatch) -> float:
    """Nats by which values without a name are farther from what the twin file declares as known."""
    rows = float((row_nats(whole.fit, runs) - row_nats(less.fit, runs)).sum())
    return whole.likelihood - less.likelihood - rows


def discover(evidence: Mapping[str, float], candidates: int) -> set[str]:
    """Names that pass e-BH. evidence : log e-values"""
    ranked = sorted(evidence, key=lambda name: -evidence[name])
    most = 0
    for rank, name in enumerate(ranked, start=1):
        if evidence[name] >= np.log(candidates / (FALSE_SHARE * rank)):
            most = rank
    return set(ranked[:most])


def _predicting(name: str, names: Names, compared: Comparison) -> list[str]:
    """Free runs over rows that were left out, with the name and without it."""
    own, less = compared.trials[names], compared.trials[names - {name}]
    if own.rmse_k > NO_WORSE * less.rmse_k:
        return [f"free runs miss left-out rows by {own.rmse_k:.3g} K with it, by {less.rmse_k:.3g} K without"]
    return []


def _worse_half(gain: Floats, half: NDArray[np.intp]) -> list[str]:
    against = [float(gain[half == i].sum()) for i in range(2)]
    if min(against) >= -AGAINST_NATS:
        return []
    which = "first" if against[0] < against[1] else "second"
    return [f"the {which} half of the data is explained better without it"]


def _apart_halves(name: str, two: Sequence[FittedTwin]) -> list[str]:
    said = []
    for i, item in enumerate(two[0].free):
        if item.place[:2] != ("effects", name):
            continue
        apart = abs(float(two[0].coordinates[i] - two[1].coordinates[i]))
        sd = float(np.sqrt(two[0].covariance[i, i] + two[1].covariance[i, i]))
        if apart > max(APART_SDS * sd, HALVES_APART):
            values = [item.value(float(each.coordinates[i])) for each in two]
            said.append(
                f"the halves of the data contradict each other: {item.place[2]} is {values[0]:.3g} "
                f"and {values[1]:.3g}"
            )
    return said
