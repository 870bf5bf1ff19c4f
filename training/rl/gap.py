"""Sim-to-real: a policy in the model it was trained in and on the virtual rig, on the same course.

The rig runs first. Its room, its reference and the rows before are then given to the model, so that nothing
differs but the box. The reference is drawn at random: it is none that controllers are compared on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.controllers.rl import Rl
from edge.core.errors import DataError
from edge.models.onnx_policy import OnnxPolicy
from edge.tick.reference import Reference
from training.rl.boxes import START_ROWS, World
from training.rl.episodes import Episode, EpisodeSettings, EpisodeStart, RepeatedEpisode, draw_reference
from training.rl.models import StepModel
from training.rl.play import Act, play
from training.rl.reward import WEIGHTS, reward
from training.rl.rig import ROOM_C, Ticks, run_on_rig

LEAD_STEPS = 40  # the rig begins cold; it is judged from here on
STEPS = 240
RIG_SEEDS = (301, 302, 303)  # of boards that nothing is trained, chosen or compared on


@dataclass(frozen=True, slots=True)
class PolicyGap:
    """One policy, means over the same steps in its model and on the rig."""

    model_mae_k: float
    rig_mae_k: float  # measured
    model_reward: float  # of a step
    rig_reward: float


def gap_of(policy: OnnxPolicy, model: StepModel, seeds: Sequence[int] = RIG_SEEDS) -> PolicyGap:
    """Means over the boards with these seeds. Errors: DataError where the rig was not the policy's alone"""
    return _mean([_gap(policy, model, seed) for seed in seeds])


def _gap(policy: OnnxPolicy, model: StepModel, seed: int) -> PolicyGap:
    values = draw_reference(
        np.random.default_rng(seed), EpisodeSettings(steps=LEAD_STEPS + STEPS + 1), ROOM_C
    )
    course = Reference(60.0 * np.arange(len(values), dtype=np.float64), values)
    ticks = run_on_rig(Rl(policy.name, policy), course, LEAD_STEPS + STEPS, seed)
    if not ticks.decided.all() or not np.isfinite(ticks.temp).all():
        raise DataError(f"board {seed}: a tick was not the policy's, or not measured")
    judged = ticks.since(LEAD_STEPS)
    weights = WEIGHTS[policy.name]
    earned = reward(judged.error_k, judged.duty[:-1], judged.fan[:-1], weights)
    world = World(model, RepeatedEpisode(episode_of(ticks)), weights)
    played = play(_act(policy), world, count=1, seed=seed)
    return PolicyGap(played.mae_k, float(np.abs(judged.error_k).mean()), played.reward, float(earned.mean()))


def episode_of(ticks: Ticks) -> Episode:
    """Return the episode that the rig has met since LEAD_STEPS."""
    judged, before = ticks.since(LEAD_STEPS), slice(LEAD_STEPS + 1 - START_ROWS, LEAD_STEPS + 1)
    start = EpisodeStart(ticks.temp[before], ticks.ambient[before], ticks.duty[before], ticks.fan[before])
    return Episode(judged.reference, judged.ambient, start)


def _act(policy: OnnxPolicy) -> Act:
    return lambda observations: policy.values(observations.astype(np.float64)).argmax(axis=1)


def _mean(gaps: Sequence[PolicyGap]) -> PolicyGap:
    return PolicyGap(*(float(np.mean([getattr(gap, name) for gap in gaps])) for name in PolicyGap.__slots__))
