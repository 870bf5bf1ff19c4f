"""Sim-to-real: a policy in the model it was trained in and on the virtual rig, on the same course.

The rig runs first. Its room, its reference and the rows before are then given to the model, so that nothing
differs but the box. The reference is drawn at random: it is none that controllers are compared on.
"""

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.controllers.rl import Rl
from edge.core.errors import DataError
from edge.lab.episodes import EpisodeSettings, draw_reference
from edge.models.onnx_policy import OnnxPolicy, read_policy
from edge.tick.reference import Reference
from training.rl.boxes import START_ROWS, World
from training.rl.episodes import Episode, EpisodeStart, RepeatedEpisode
from training.rl.models import StepModel
from training.rl.reward import WEIGHTS, reward
from training.rl.rig import ROOM_C, Ticks, run_on_rig
from training.rl.saved_policy import POLICY_FILE, Record, read_record
from training.rl.study import Act, play

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
    played = play(act_of(policy), world, count=1, seed=seed)
    return PolicyGap(played.mae_k, float(np.abs(judged.error_k).mean()), played.reward, float(earned.mean()))


def episode_of(ticks: Ticks) -> Episode:
    """Return the episode that the rig has met since LEAD_STEPS."""
    judged, before = ticks.since(LEAD_STEPS), slice(LEAD_STEPS + 1 - START_ROWS, LEAD_STEPS + 1)
    start = EpisodeStart(ticks.temp[before], ticks.ambient[before], ticks.duty[before], ticks.fan[before])
    return Episode(judged.reference, judged.ambient, start)


def act_of(policy: OnnxPolicy) -> Act:
    """Return the choice of a rig's file."""
    return lambda observations: policy.values(observations.astype(np.float64)).argmax(axis=1)


def _mean(gaps: Sequence[PolicyGap]) -> PolicyGap:
    return PolicyGap(*(float(np.mean([getattr(gap, name) for gap in gaps])) for name in PolicyGap.__slots__))


_COLUMNS = ("model", "rig", "gap", "model", "rig", "gap")
_HEAD = f"{'policy':9s} {'parameters':11s} {'seed':>12s}" + "".join(f"{name:>15s}" for name in _COLUMNS)


def gap_table(groups: Sequence[tuple[str, Sequence[Path]]], model: StepModel, command: str) -> Iterator[str]:
    """Lines, one as soon as it is known; groups : (how the parameters were, folders of policies)."""
    yield f"# {command}"
    yield f"# Model {model.name} {model.sha256[:12]}; boards {', '.join(map(str, RIG_SEEDS))}; {STEPS} steps"
    yield f"# of a minute after {LEAD_STEPS} of lead-in, references drawn at random by the board's seed."
    yield "# MAE [K]: of the true air in the model, of the measured air on the rig; then reward of a step,"
    yield "# and the gap: rig less model. parameters: of the training model, drawn: uniformly within their"
    yield "# 95 % intervals, anew for each episode. The last lines of a group: mean ± sd over its seeds."
    yield f"{'':34s}{'MAE [K]':>30s}{'reward of a step':>45s}"
    yield _HEAD
    for parameters, folders in groups:
        found: list[PolicyGap] = []
        for folder in folders:
            record = read_record(folder)
            gap = gap_of(read_policy(folder / POLICY_FILE, record["variant"]), model)
            found.append(gap)
            yield _name(record, parameters, str(record["seed"])) + _cells([gap])
        if found:
            yield _name(record, parameters, f"all {len(found)}") + _cells(found)


def hashes(groups: Sequence[tuple[str, Sequence[Path]]]) -> Iterator[str]:
    """Lines: which policies the table is about."""
    for _, folders in groups:
        for folder in folders:
            record = read_record(folder)
            yield f"# {record['variant']} seed {record['seed']} {record['policy']}: {record['command']}"


def _name(record: Record, parameters: str, seed: str) -> str:
    return f"{record['variant']:9s} {parameters:11s} {seed:>12s}"


def _cells(gaps: Sequence[PolicyGap]) -> str:
    columns = (
        [gap.model_mae_k for gap in gaps],
        [gap.rig_mae_k for gap in gaps],
        [gap.rig_mae_k - gap.model_mae_k for gap in gaps],
        [gap.model_reward for gap in gaps],
        [gap.rig_reward for gap in gaps],
        [gap.rig_reward - gap.model_reward for gap in gaps],
    )
    return "".join(f"{_spread(column):>15s}" for column in columns)


def _spread(values: Sequence[float]) -> str:
    if len(values) == 1:
        return f"{values[0]:.3f}"
    return f"{statistics.fmean(values):.3f} ± {statistics.stdev(values):.3f}"
