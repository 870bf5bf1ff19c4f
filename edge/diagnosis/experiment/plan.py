"""The next experiment: what separates the rivals of a diagnosis best within the limits of safety."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.experiment.separation import RivalPair, Separation, separation
from edge.diagnosis.experiment.sequence import ExperimentLimits, SequenceInputs, candidates, surroundings
from edge.diagnosis.twin_fit import FittedTwin
from edge.twin.twin_file import Place

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Names = tuple[str, ...]
RIVAL_NATS = 3.0  # log odds that leave a question open
MOST_RIVALS = 3  # of an effect, the nearest ones
SAME_NATS = 0.3  # below it, by every experiment, two models say the same
SECOND = np.log(2.0) / 3600.0  # what the rig's time is worth: an hour must double the evidence
SETTLED_NATS = 10.0  # log odds that leave no question


@dataclass(frozen=True, slots=True, eq=False)
class PlannedExperiment:
    """The next experiment.

    profile : columns for `greenhouse experiment`; none where no experiment with heater and fan helps
    kind : of experiment, in words
    separates : groups of effects that it tells apart
    expected_log_odds : of the true one over the one that is hardest to tell from it [nat]
    inseparable : groups of effects that say the same whatever heater and fan do
    weak : pairs of which it tells too little
    calibration : a value that would settle it if it were exactly known, and the log odds then [nat]
    inputs : what an experiment may switch, in words
    """

    profile: Mapping[str, Floats] = field(default_factory=dict)
    kind: str = ""
    separates: tuple[Names, ...] = ()
    expected_log_odds: float | None = None
    largest_temp_air_c: float | None = None
    inseparable: tuple[Names, ...] = ()
    weak: tuple[Names, ...] = ()
    calibration: tuple[Place, float] | None = None
    inputs: str = "heater and fan"

    @property
    def names(self) -> list[str]:
        """Effects that it tells apart."""
        return list(dict.fromkeys(name for group in self.separates for name in group))

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return float(self.profile["time_s"][-1]) if self.profile else 0.0


def next_experiment(found: Diagnosis, limits: ExperimentLimits) -> PlannedExperiment | None:
    """Plan the experiment that separates the named effects from their rivals; None where no rival is near."""
    models, pairs = open_rivals(found)
    if not pairs:
        return None
    file, recorded = found.inputs.file, any("fan_on" in named.run.columns for named in found.data.train)
    around = surroundings(found.inputs.runs, found.inputs.guessed, recorded and file.fan_role != "none")
    return design_experiment(separation(models, pairs, around, limits.row_s(file.sample_s)), limits)


def open_rivals(found: Diagnosis) -> tuple[list[FittedTwin], list[RivalPair]]:
    """Return the best set and its alternatives, and the pairs: none where no question is open."""
    tried, names = found.choice.tried, frozenset(effect.name for effect in found.verdict.effects)
    models, pairs = [tried[names].fit] if names in tried else [], list[RivalPair]()
    for effect in found.verdict.effects if models else ():
        nearest = max(effect.alternatives.values(), default=0.0)
        members = [(0, effect.name, 1.0)]
        for other, log_odds in effect.alternatives.items():
            rival = tried.get(names - {effect.name} | {other})
            if rival is not None and log_odds >= nearest - RIVAL_NATS and len(members) <= MOST_RIVALS:
                members.append((len(models), other, float(np.exp(log_odds))))
                models.append(rival.fit)
        for (i, name, likely), (j, other, likely_too) in combinations(members, 2):
            pairs.append(RivalPair((i, j), (name, other), (likely, likely_too)))
    return models, pairs


def design_experiment(plan: Separation, limits: ExperimentLimits) -> PlannedExperiment:
    """Return the most informative experiment, one without a profile where no experiment is informative."""
    pairs, tried = plan.pairs, candidates(limits, plan.around, plan.row_s)
    if tried is not None:
        warmest_c = plan.predicted_c(tried).max(axis=(0, 2))
        tried = tried.choose(np.flatnonzero(warmest_c <= limits.highest_c))  # NaN is too warm
    if tried is None or not tried.kinds:
        every = np.ones(len(pairs), dtype=bool)
        return PlannedExperiment(weak=_names(pairs, every), calibration=_calibration(plan, every, 0.0))
    log_odds = plan.log_odds(tried)
    most = log_odds.max(axis=(1, 2))
    same = most < SAME_NATS
    groups = _groups(_names(pairs, same))
    inputs = "heater and fan" if plan.around.has_fan else "the heater alone"
    if same.all():
        return PlannedExperiment(inseparable=groups, calibration=_calibration(plan, same, 0.0), inputs=inputs)
    telling = most >= RIVAL_NATS if (most >= RIVAL_NATS).any() else ~same
    # First the pairs that are settled, then the mean logarithm: what is hard to tell counts most.
    settled = log_odds.min(axis=1) >= RIVAL_NATS
    weights = np.where(telling[:, None], [pair.likelihoods for pair in pairs], 0.0)
    worth = np.einsum("pw,pwb->b", weights / weights.sum(), np.log1p(log_odds))
    worth -= SECOND * tried.row_s * tried.within.sum(axis=1)
    best = int(np.where(settled.sum(axis=0) == settled.sum(axis=0).max(), worth, -np.inf).argmax())
    chosen, settled = tried.choose(np.array([best])), settled[:, best]
    apart = settled if settled.any() else telling
    expected = float(log_odds[apart, :, best].min())
    return PlannedExperiment(
        profile=_profile(chosen, plan.around.has_light),
        kind=chosen.kinds[0],
        separates=_groups(_names(pairs, apart)),
        expected_log_odds=expected,
        largest_temp_air_c=float(plan.predicted_c(chosen).max()),
        inseparable=groups,
        weak=_names(pairs, ~(settled | same | apart)),
        calibration=_calibration(plan, apart, expected),
        inputs=inputs,
    )


def _profile(chosen: SequenceInputs, lit: bool) -> dict[str, Floats]:
    """Return a row where an input changes, and one at the end."""
    rows = int(chosen.within.sum())
    columns = {"heater_duty": chosen.wanted[0], "fan_on": chosen.fan[0]}
    if lit:
        columns["light"] = chosen.light[0]
    values = np.array([column[:rows] for column in columns.values()])
    changed = np.flatnonzero(np.any(np.diff(values, axis=1, prepend=-1.0) != 0.0, axis=0))
    profile = {"time_s": chosen.row_s * np.append(changed, rows)}
    return profile | {name: np.append(own[changed], 0.0) for name, own in zip(columns, values, strict=True)}


def _names(pairs: Sequence[RivalPair], which: Mask) -> tuple[Names, ...]:
    return tuple(pair.names for pair, own in zip(pairs, which, strict=True) if own)


def _groups(pairs: Sequence[Names]) -> tuple[Names, ...]:
    """Return the names, those together that a chain of pairs joins."""
    groups: list[Names] = []
    for pair in pairs:
        joined = [group for group in groups if set(group) & set(pair)]
        names = dict.fromkeys(name for group in (*joined, pair) for name in group)
        groups = [group for group in groups if group not in joined] + [tuple(names)]
    return tuple(groups)


def _calibration(plan: Separation, pairs: Mask, expected: float) -> tuple[Place, float] | None:
    """Return the value that tells most if it is exactly known, None where none would settle much more.

    pairs : those that it is for; expected : log odds by the experiment
    """
    values = plan.models[0].file.values()
    shared = set.intersection(*({item.place for item in model.free} for model in plan.models))
    uncertain = sorted(place for place in shared if values[place].rel_sd is not None)
    alone = [(float(plan.by_calibration(place)[pairs].min()), place) for place in uncertain]
    log_odds, place = max(alone, default=(0.0, ()))
    helps = expected < SETTLED_NATS and log_odds >= expected + RIVAL_NATS
    return (place, log_odds) if helps else None
