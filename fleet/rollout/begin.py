"""A rollout is begun, let go on or stopped by a person: rows in the database, which the runner takes up."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from sqlalchemy import Engine, select, update
from sqlalchemy.orm import Session

from edge.core.errors import RequestError
from fleet.database.tables import BundleRollout, FleetBundle, FleetRig, RolloutRig, RolloutWave
from fleet.rollout.judge import JudgeRules
from fleet.rollout.states import OPEN, RigState, RolloutState, WaveState
from fleet.settings import RolloutSettings

SHARES = (0.01, 0.10, 1.0)  # of each kind that has the bundle after a wave
LEAST_OF_KIND = 6  # new rigs of a kind in a wave: of four, all may be of the few that a bad bundle suits


@dataclass(frozen=True, slots=True)
class KindRigs:
    """Rigs of one kind. total : that the bundle is for; waiting : that could get it now, by name"""

    total: int
    waiting: Sequence[str]


def is_last(wave: int) -> bool:
    """Return whether a wave is for all that is left. wave : from 1"""
    return wave >= len(SHARES)


def choose_wave(wave: int, kinds: Mapping[str, KindRigs], reached: Mapping[str, int], seed: str) -> list[str]:
    """Return the rigs of a wave.

    All but the last wave leave as many rigs of a kind waiting as they take, to be compared with. So a kind
    with a single rig has its turn in the last wave.

    wave : from 1; reached : rigs of each kind that had the bundle ordered before
    seed : the same one gives the same choice
    """
    chosen: list[str] = []
    for kind, rigs in sorted(kinds.items()):
        count = wave_size(wave, rigs.total, reached.get(kind, 0), len(rigs.waiting))
        chosen += random.Random(f"{seed} {wave} {kind}").sample(sorted(rigs.waiting), count)
    return chosen


def wave_size(wave: int, total: int, reached: int, waiting: int) -> int:
    """Return how many rigs of a kind a wave takes."""
    if is_last(wave):
        return waiting
    wanted = max(ceil(SHARES[wave - 1] * total) - reached, LEAST_OF_KIND)
    return min(wanted, waiting // 2)


def begin(engine: Engine, settings: RolloutSettings, sha256: str, group: str, utc: float) -> int:
    """Begin a rollout of an archive that is in the database, and return its number.

    group : of rigs; "" for the whole fleet
    Errors : RequestError where another one runs, no rig is there, or rigs could not fetch anything
    """
    if not settings.address:
        raise RequestError("rollout.address is empty: rigs could fetch no bundle")
    with Session(engine) as session, session.begin():
        bundle = session.get(FleetBundle, sha256)
        if bundle is None:
            raise RequestError(f"there is no bundle of sha256 {sha256}")
        running = session.scalar(select(BundleRollout).where(BundleRollout.state == RolloutState.RUNNING))
        if running is not None:
            raise RequestError(f"rollout {running.number} of bundle {running.version} runs: stop it before")
        asked = select(FleetRig.name).where(FleetRig.group == group) if group else select(FleetRig.name)
        if session.scalar(asked.limit(1)) is None:
            raise RequestError(f"no rig is in {f'group {group}' if group else 'the fleet'}")
        rollout = BundleRollout(
            sha256=sha256,
            version=bundle.version,
            group=group,
            state=RolloutState.RUNNING,
            margin=settings.margin,
            error=settings.error,
            wave_h=settings.wave_h,
            began_utc=utc,
        )
        session.add(rollout)
        session.flush()
        return rollout.number


def stop(session: Session, rollout: BundleRollout, why: str, utc: float) -> None:
    """End a rollout; every rig that may have its bundle is to roll back."""
    rollout.state, rollout.ended_utc, rollout.why = RolloutState.STOPPED, utc, why
    wave = session.get(RolloutWave, (rollout.number, rollout.wave))
    if wave is not None:
        wave.state, wave.ended_utc, wave.why = WaveState.STOPPED, utc, why
    for row in rigs_of(session, rollout):
        if row.state in OPEN:
            row.state, row.since_utc, row.sent_utc = RigState.ROLLING_BACK, utc, 0.0


def stop_by_person(engine: Engine, number: int, why: str, utc: float) -> None:
    """Stop a rollout that runs. Errors: RequestError"""
    with Session(engine) as session, session.begin():
        stop(session, _running(session, number), why, utc)


def go_on_by_person(engine: Engine, number: int, why: str, utc: float) -> int:
    """Let a wave pass that is held, and return which one. Errors: RequestError"""
    with Session(engine) as session, session.begin():
        rollout = _running(session, number)
        wave = session.get(RolloutWave, (number, rollout.wave))
        if wave is None or wave.state != WaveState.HELD:
            state = "has not begun" if wave is None else f"is {wave.state}"
            raise RequestError(
                f"rollout {number}: wave {rollout.wave} {state}: only one that is held can go on"
            )
        wave.state, wave.ended_utc, wave.why = WaveState.PASSED, utc, f"{why}; {wave.why}"
        return wave.wave


def lock(session: Session, number: int) -> BundleRollout | None:
    """Return a rollout as it is now; until the transaction ends nobody else decides about it.

    SQLite has no lock of a row, and a read alone would let two decide at once: so it is written first.
    """
    own = update(BundleRollout).where(BundleRollout.number == number).values(wave=BundleRollout.wave)
    session.execute(own, execution_options={"synchronize_session": False})
    return session.get(BundleRollout, number, populate_existing=True)


def _running(session: Session, number: int) -> BundleRollout:
    rollout = lock(session, number)
    if rollout is None:
        raise RequestError(f"there is no rollout {number}")
    if rollout.state != RolloutState.RUNNING:
        raise RequestError(f"rollout {number} is {rollout.state} already")
    return rollout


def rules_of(rollout: BundleRollout) -> JudgeRules:
    """Return the rules with which a rollout began."""
    return JudgeRules(rollout.margin, rollout.error, len(SHARES))


def rigs_of(session: Session, rollout: BundleRollout) -> list[RolloutRig]:
    """Return the rigs that a rollout has reached, by name."""
    asked = select(RolloutRig).where(RolloutRig.rollout == rollout.number).order_by(RolloutRig.rig)
    return list(session.scalars(asked))
