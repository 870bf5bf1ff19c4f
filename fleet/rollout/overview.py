"""Rollouts as people look at them: the newest first, each with its waves and the rigs that complain."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Engine, and_, func, or_, select, true
from sqlalchemy.orm import Session

from edge.core.plain_text import plain
from fleet.database.tables import BundleRollout, RolloutRig, RolloutWave
from fleet.rollout.begin import rules_of
from fleet.rollout.states import (
    ANSWER_MAX_S,
    OFFLINE_MAX_S,
    RigState,
    RolloutState,
    WaveState,
    complaint,
)

Json = dict[str, Any]
Groups = frozenset[str] | None  # of which somebody may see rollouts; None: all, and those of the whole fleet

COMPLAINTS_MAX = 20  # of each rollout
ROLLOUT_KEYS = ("number", "version", "group", "state", "why", "margin", "wave", "began_utc", "ended_utc")
WAVE_KEYS = ("wave", "state", "why", "began_utc", "ended_utc", "kinds")
RIG_KEYS = ("rig", "kind", "wave", "state")


def newest(engine: Engine, groups: Groups, utc: float, most: int | None = None) -> Json:
    """Return `rollouts`, the newest first, and how many were left off.

    Each has its waves, with rigs by state and figures by kind, and its rigs that complain, with how many of
    them were left off. The runner counts from when it began to listen, so a complaint may be shown here
    before it counts there.

    most : rollouts to return, None for all; utc : now, in seconds since 1970
    """
    asked = select(BundleRollout).where(_of(groups)).order_by(BundleRollout.number.desc()).limit(most)
    with Session(engine) as session:
        total = session.scalar(select(func.count()).select_from(BundleRollout).where(_of(groups))) or 0
        rollouts = session.scalars(asked).all()
        waves = _waves(session, [rollout.number for rollout in rollouts])
        complaints = _complaints(session, rollouts, utc)
    return {
        "rollouts": [
            {key: getattr(rollout, key) for key in ROLLOUT_KEYS}
            | {"waves": waves[rollout.number], "safe_from": rules_of(rollout).safe_from}
            | {"complaints": complaints[rollout.number][:COMPLAINTS_MAX]}
            | {"complaints_left_off": max(0, len(complaints[rollout.number]) - COMPLAINTS_MAX)}
            for rollout in rollouts
        ],
        "left_off": total - len(rollouts),
    }


def waiting_numbers(engine: Engine, groups: Groups) -> list[int]:
    """Return the numbers of the rollouts that wait for a person."""
    asked = (
        select(BundleRollout.number)
        .join(RolloutWave, RolloutWave.rollout == BundleRollout.number)
        .where(RolloutWave.wave == BundleRollout.wave, RolloutWave.state == WaveState.HELD)
        .where(BundleRollout.state == RolloutState.RUNNING, _of(groups))
    )
    with Session(engine) as session:
        return list(session.scalars(asked.order_by(BundleRollout.number)))


def group_of(engine: Engine, number: int) -> str | None:
    """Return the group of a rollout, "" for the whole fleet, None where there is no such rollout."""
    with Session(engine) as session:
        return session.scalar(select(BundleRollout.group).where(BundleRollout.number == number))


def _of(groups: Groups) -> ColumnElement[bool]:
    return true() if groups is None else BundleRollout.group.in_(groups)


def _waves(session: Session, numbers: Sequence[int]) -> dict[int, list[Json]]:
    states: dict[tuple[int, int], Counter[str]] = {}
    counted = select(RolloutRig.rollout, RolloutRig.wave, RolloutRig.state, func.count())
    counted = counted.where(RolloutRig.rollout.in_(numbers))
    for rollout, wave, state, count in session.execute(
        counted.group_by(RolloutRig.rollout, RolloutRig.wave, RolloutRig.state)
    ):
        states.setdefault((rollout, wave), Counter())[state] = count
    found: dict[int, list[Json]] = {number: [] for number in numbers}
    waves = select(RolloutWave).where(RolloutWave.rollout.in_(numbers))
    for row in session.scalars(waves.order_by(RolloutWave.wave)):
        counts = states.get((row.rollout, row.wave), Counter())
        rigs = {state: counts[state] for state in RigState if counts[state]}
        found[row.rollout].append({key: getattr(row, key) for key in WAVE_KEYS} | {"rigs": rigs})
    return found


def _complaints(session: Session, rollouts: Sequence[BundleRollout], utc: float) -> dict[int, list[Json]]:
    """Return the rigs that count as unhealthy or have said why they are as they are, by rollout."""
    running = {rollout.number for rollout in rollouts if rollout.state == RolloutState.RUNNING}
    found: dict[int, list[Json]] = {rollout.number: [] for rollout in rollouts}
    for row in session.scalars(
        select(RolloutRig)
        .where(RolloutRig.rollout.in_(found), or_(RolloutRig.why != "", _is_late(utc)))
        .order_by(RolloutRig.rig)
    ):
        # What a rig has not done counts only as long as somebody waits for it.
        why = (complaint(row, utc) if row.rollout in running else "") or row.why
        if why:
            found[row.rollout].append({key: getattr(row, key) for key in RIG_KEYS} | {"why": plain(why)})
    return found


def _is_late(utc: float) -> ColumnElement[bool]:
    """Return the condition for a complaint about a rig that has said nothing: of thousands, few are read."""
    return or_(
        RolloutRig.offline_utc < utc - OFFLINE_MAX_S,
        and_(RolloutRig.state == RigState.ORDERED, RolloutRig.since_utc < utc - ANSWER_MAX_S),
    )
