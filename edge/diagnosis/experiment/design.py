"""The next experiment: what separates the rivals of a diagnosis best within the limits of safety."""

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.experiment.advice import calibrate_first, swung
from edge.diagnosis.experiment.experiment import PlannedExperiment, ProfileRow, Sides
from edge.diagnosis.experiment.families import (
    SAME_NATS,
    ExperimentScores,
    candidates,
    cool,
    evaluate,
    improve,
)
from edge.diagnosis.experiment.rivals import RIVAL_NATS, RivalPair, Rivals, open_rivals
from edge.diagnosis.experiment.separation import Separation, separation
from edge.diagnosis.experiment.sequence import ExperimentLimits, SequenceInputs
from edge.diagnosis.experiment.surroundings import surroundings

LIKELY = 0.05  # share from which on an effect may well be the true one

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def next_experiment(found: Diagnosis, limits: ExperimentLimits) -> PlannedExperiment | None:
    """Plan the experiment that separates the named effects from their rivals; None where no rival is near."""
    rivals = open_rivals(found)
    if rivals is None:
        return None
    around = surroundings(found.inputs.runs, found.inputs.guessed)
    plan = separation(rivals, around, limits.row_s(found.inputs.file.sample_s))
    return design_experiment(plan, limits)


def design_experiment(plan: Separation, limits: ExperimentLimits) -> PlannedExperiment:
    """Return the most informative experiment, one without a profile where no experiment is informative."""
    passed = cool(plan, candidates(limits, plan.row_s, _lit(plan)), limits)
    pairs = plan.rivals.pairs
    if passed is None:
        return PlannedExperiment(weak=_unordered_pairs(pairs, np.ones(len(pairs), dtype=bool)))
    every = evaluate(plan, passed.strongest())
    most = every.log_odds.max(axis=1)
    told = most >= (RIVAL_NATS if (most >= RIVAL_NATS).any() else SAME_NATS)
    same = _same(pairs, most)
    if not told.any():
        return _without_profile(plan, every, same)
    weights = np.where(told, [pair.weight for pair in pairs], 0.0)
    weights /= weights.sum()
    chosen = improve(plan, every.best(weights), weights, limits)
    return _experiment(plan, chosen, told, same)


def _lit(plan: Separation) -> bool:
    """Return whether the light was recorded and acts in any of the models."""
    needs = {column for model in plan.models for column in model.file.twin().needs}
    return "light" in needs & set(plan.around.columns)


def _experiment(plan: Separation, chosen: ExperimentScores, told: Mask, same: Mask) -> PlannedExperiment:
    pairs, log_odds = plan.rivals.pairs, chosen.log_odds[:, 0]
    settled = _both_ways(pairs, log_odds >= RIVAL_NATS)
    apart = _likely(pairs, told & settled)
    if not apart.any():
        apart = _likely(pairs, told)
    expected = float(log_odds[apart].min())
    hard = ~told & ~same
    return PlannedExperiment(
        profile=_profile(chosen.cool.inputs, _lit(plan)),
        kind=chosen.cool.candidates[0].what,
        separates=_sides(pairs, apart, ~settled & ~_either_way(pairs, apart)),
        expected_log_odds=expected,
        largest_temp_air_c=float(chosen.cool.highest_c[0]),
        between={
            f"{pair.true_name} over {pair.other_name}": float(value)
            for pair, value in zip(pairs, log_odds, strict=True)
        },
        inseparable=_groups(plan.rivals, same),
        weak=_unordered_pairs(pairs, _likely(pairs, ~settled & ~same)),
        calibration=calibrate_first(plan, apart, chosen, expected),
        swing_log_odds=swung(plan, chosen, hard) if hard.any() else None,
    )


def _without_profile(plan: Separation, every: ExperimentScores, same: Mask) -> PlannedExperiment:
    """For models that say the same whatever heater and fan do."""
    return PlannedExperiment(
        inseparable=_groups(plan.rivals, same),
        calibration=calibrate_first(plan, same, None, 0.0),
        swing_log_odds=swung(plan, every, same),
    )


def _likely(pairs: tuple[RivalPair, ...], which: Mask) -> Mask:
    """Return the pairs in which both effects are likely; all pairs if there are none."""
    shares = {pair.true: pair.share for pair in pairs}
    both = np.array([min(pair.share, shares[pair.other]) >= LIKELY for pair in pairs])
    return which & both if (which & both).any() else which


def _profile(inputs: SequenceInputs, lit: bool) -> tuple[ProfileRow, ...]:
    """Return a row where an input changes, and one at the end."""
    rows = int(inputs.within[0].sum())
    columns = np.stack([inputs.wanted[0, :rows], inputs.fan[0, :rows], inputs.light[0, :rows]])
    changed = np.flatnonzero(np.any(np.diff(columns, axis=1, prepend=-1.0) != 0.0, axis=0))
    found = [
        ProfileRow(
            float(k * inputs.row_s),
            float(columns[0, k]),
            float(columns[1, k]),
            float(columns[2, k]) if lit else None,
        )
        for k in changed
    ]
    return (*found, ProfileRow(rows * inputs.row_s, 0.0, 0.0, 0.0 if lit else None))


def _either_way(pairs: tuple[RivalPair, ...], holds: Mask) -> Mask:
    """Return whether a condition holds for a pair in either order."""
    known = {frozenset((pair.true, pair.other)) for pair, own in zip(pairs, holds, strict=True) if own}
    return np.array([frozenset((pair.true, pair.other)) in known for pair in pairs])


def _both_ways(pairs: tuple[RivalPair, ...], holds: Mask) -> Mask:
    """Return whether a condition holds for a pair in both orders."""
    known = {(pair.true, pair.other) for pair, own in zip(pairs, holds, strict=True) if own}
    return np.array([{(pair.true, pair.other), (pair.other, pair.true)} <= known for pair in pairs])


def _same(pairs: tuple[RivalPair, ...], most: Floats) -> Mask:
    """Pairs that no experiment tells anything of, whichever is the true one."""
    return ~_either_way(pairs, most >= SAME_NATS)


def _unordered_pairs(pairs: tuple[RivalPair, ...], which: Mask) -> tuple[tuple[str, str], ...]:
    chosen = [pair for pair, own in zip(pairs, which, strict=True) if own and pair.true < pair.other]
    return tuple((pair.true_name, pair.other_name) for pair in chosen)


def _sides(pairs: tuple[RivalPair, ...], apart: Mask, unsaid: Mask) -> tuple[Sides, ...]:
    """For each effect's place, who is told from whom; names together that are not told from one another."""
    found = []
    for place in dict.fromkeys(pair.place for pair in pairs):
        here = [(pair, own) for pair, own in zip(pairs, apart, strict=True) if pair.place == place]
        names = dict.fromkeys(name for pair, own in here if own for name in (pair.true_name, pair.other_name))
        alike = {name: {name} for name in names}
        for pair, own in zip(pairs, unsaid, strict=True):
            if own and pair.place == place and {pair.true_name, pair.other_name} <= set(names):
                alike[pair.true_name].add(pair.other_name)
        sides = {frozenset(group): tuple(own for own in names if own in group) for group in alike.values()}
        if len(sides) > 1:
            found.append(tuple(sides.values()))
    return tuple(found)


def _groups(rivals: Rivals, same: Mask) -> tuple[tuple[str, ...], ...]:
    """Effects that say the same, those together that are the same as one another."""
    groups: list[list[str]] = []
    for one, other in _unordered_pairs(rivals.pairs, same):
        home = next((group for group in groups if one in group or other in group), None)
        if home is None:
            groups.append([one, other])
        else:
            home.extend(name for name in (one, other) if name not in home)
    return tuple(tuple(group) for group in groups)
