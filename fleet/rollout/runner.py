"""The runner of rollouts: hears rigs, takes blocks, judges, goes on or stops, and sends orders.

Each look is one transaction, and orders are sent after it, again and again until a rig answers. So a kill at
any moment costs at most an order that comes twice, which rigs allow.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from math import ceil

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from fleet.database.tables import BundleRollout, FleetRig, RolloutBlock, RolloutRig, RolloutWave, are_there
from fleet.rollout.archives import archive_url
from fleet.rollout.begin import KindRigs, choose_wave, is_last, lock, rigs_of, rules_of, stop
from fleet.rollout.blocks import Costs, due, take_block, who_compares
from fleet.rollout.judge import HOUR_S, Verdict, judge
from fleet.rollout.rig_line import RigLine
from fleet.rollout.states import RigState, RolloutState, WaveState, harm, take_news

AGAIN_S = 300.0  # until an order that was not answered is sent again
SETTLE_S = 3600.0  # after a change a controller's estimate and the box come to rest


class DecidedMeanwhile(Exception):
    """A person has stopped a rollout, or let it go on, since a look began."""


class RolloutRunner:
    """Looks at everything at each call of `look`.

    address : `rollout.address`; hearing_utc : since when rigs are heard; 0.0: since ever
    check : of the `FleetLease` that its holder has, so that of two runners one alone writes and sends
    """

    def __init__(
        self,
        engine: Engine,
        address: str,
        line: RigLine,
        costs: Costs,
        check: Callable[[Session], None],
        hearing_utc: float = 0.0,
    ) -> None:
        self._hearing_utc, self._check = hearing_utc, check
        self._engine, self._address, self._line, self._costs = engine, address, line, costs
        self.problem = ""  # why numbers could not be read at the last look

    def look(self, utc: float) -> list[str]:
        """Do all that is due and return what happened, a line each; nothing while rigs can't be heard.

        Errors : LeaseLost where another runner has taken over; then nothing was written or sent
        """
        if not self._line.hears():
            self._hearing_utc = utc
            return []
        self.problem = ""
        told: list[str] = []
        try:
            with Session(self._engine) as session, session.begin():
                asked = select(BundleRollout).where(BundleRollout.state == RolloutState.RUNNING)
                running = session.scalars(asked).all()
                self._hear(session, utc)
                for rollout in running:
                    told += self._advance(session, rollout, utc)
                self._check(session)
        except DecidedMeanwhile:
            return []  # nothing was written; the next look sees what they did, and hears the same news
        self._line.confirm()
        self._send(utc)
        return told

    def _hear(self, session: Session, utc: float) -> None:
        rows: dict[str, list[tuple[RolloutRig, BundleRollout]]] = {}
        states = (*(state for state in RigState if state != RigState.ROLLED_BACK),)
        asked = (
            select(RolloutRig, BundleRollout)
            .join(BundleRollout, RolloutRig.rollout == BundleRollout.number)
            .where(RolloutRig.state.in_(states), BundleRollout.state != RolloutState.DONE)
        )
        for row, rollout in session.execute(asked):
            rows.setdefault(row.rig, []).append((row, rollout))
        for news in self._line.news():
            for row, rollout in rows.get(news.rig, ()):
                take_news(row, news, rollout.sha256, rollout.version, utc)

    def _advance(self, session: Session, rollout: BundleRollout, utc: float) -> list[str]:
        """Take the next step of a rollout that runs."""
        wave = session.get(RolloutWave, (rollout.number, rollout.wave))
        kinds = None
        if wave is not None and wave.state in (WaveState.JUDGING, WaveState.HELD):
            kinds = self._blocks(session, rollout, wave, utc)
        _hold_people_off(session, rollout, wave)  # now: on SQLite nobody can write, and costs take their time
        if why := harm(rigs_of(session, rollout), utc, self._hearing_utc):
            return [self._stop(session, rollout, why, utc)]
        if wave is None or wave.state == WaveState.PASSED:
            return self._next_wave(session, rollout, utc)
        if wave.state == WaveState.INSTALLING:
            return self._await_rigs(session, rollout, wave, utc)
        return [] if kinds is None else self._judge(session, rollout, wave, kinds, utc)

    def _stop(self, session: Session, rollout: BundleRollout, why: str, utc: float) -> str:
        stop(session, rollout, why, utc)
        return f"rollout {rollout.number} is stopped in wave {rollout.wave}: {why}"

    def _next_wave(self, session: Session, rollout: BundleRollout, utc: float) -> list[str]:
        if is_last(rollout.wave):
            return [self._end(session, rollout, utc)]
        if session.scalar(select(FleetRig.name).where(are_there(utc)).limit(1)) is None:
            return []  # nobody is heard, as while ingest is away: a wave would pass without a rig
        rows = rigs_of(session, rollout)
        reached: dict[str, int] = {}
        for row in rows:
            reached[row.kind] = reached.get(row.kind, 0) + 1
        kinds = _kinds(session, rollout, {row.rig for row in rows}, utc)
        rollout.wave += 1
        session.add(
            RolloutWave(
                rollout=rollout.number, wave=rollout.wave, state=WaveState.INSTALLING, began_utc=utc, kinds={}
            )
        )
        session.flush()
        chosen = choose_wave(rollout.wave, kinds, reached, f"{rollout.sha256} {rollout.number}")
        for rig in (session.get_one(FleetRig, name) for name in chosen):
            session.add(
                RolloutRig(
                    rollout=rollout.number,
                    rig=rig.name,
                    kind=rig.kind,
                    wave=rollout.wave,
                    state=RigState.ORDERED,
                    since_utc=utc,
                )
            )
        return [f"rollout {rollout.number}: wave {rollout.wave} begins with {len(chosen)} rigs"]

    def _end(self, session: Session, rollout: BundleRollout, utc: float) -> str:
        left = [name for kind in _kinds(session, rollout, set(), None).values() for name in kind.waiting]
        left = sorted(set(left) - {row.rig for row in rigs_of(session, rollout)})
        rollout.state, rollout.ended_utc = RolloutState.DONE, utc
        rollout.why = "all waves have passed"
        if left:
            rollout.why += f"; away and without it: {', '.join(left)}"
        return f"rollout {rollout.number} is done: {rollout.why}"

    def _await_rigs(
        self, session: Session, rollout: BundleRollout, wave: RolloutWave, utc: float
    ) -> list[str]:
        rows = [row for row in rigs_of(session, rollout) if row.wave == wave.wave]
        if any(row.state == RigState.ORDERED for row in rows):
            return []
        if not any(row.state == RigState.ACTIVE for row in rows):
            return [self._pass(rollout, wave, "no rig runs it", utc)]
        wave.state = WaveState.JUDGING
        wave.judged_from_utc = ceil((utc + SETTLE_S) / HOUR_S) * HOUR_S
        return [f"rollout {rollout.number}: all {len(rows)} rigs of wave {wave.wave} have obeyed"]

    def _judge(
        self,
        session: Session,
        rollout: BundleRollout,
        wave: RolloutWave,
        kinds: Mapping[str, Sequence[float]],
        utc: float,
    ) -> list[str]:
        assert wave.judged_from_utc is not None
        found = judge(kinds, rules_of(rollout))
        wave.kinds = {kind: asdict(row) for kind, row in found.kinds.items()}
        if found.verdict is Verdict.WORSE:
            return [self._stop(session, rollout, found.why, utc)]
        if found.verdict is Verdict.NOT_WORSE:
            return [self._pass(rollout, wave, f"{found.verdict.value}: {found.why}", utc)]
        if utc - wave.judged_from_utc < rollout.wave_h * HOUR_S:
            return []
        if is_last(wave.wave):  # all have the bundle: nothing is left that could be spared
            return [self._pass(rollout, wave, f"time is over: {found.why}", utc)]
        return self._hold(rollout, wave, found.why)

    def _hold(self, rollout: BundleRollout, wave: RolloutWave, why: str) -> list[str]:
        """Leave a wave of which too little is known to a person; it is judged on."""
        is_news = wave.state != WaveState.HELD
        wave.state, wave.why = WaveState.HELD, why
        order = f"`greenhouse fleet rollout go-on {rollout.number}`, or `stop`"
        return [f"rollout {rollout.number}: wave {wave.wave} is held, {why}; {order}"] if is_news else []

    def _pass(self, rollout: BundleRollout, wave: RolloutWave, why: str, utc: float) -> str:
        wave.state, wave.ended_utc, wave.why = WaveState.PASSED, utc, why
        return f"rollout {rollout.number}: wave {wave.wave} has passed: {why}"

    def _blocks(
        self, session: Session, rollout: BundleRollout, wave: RolloutWave, utc: float
    ) -> Mapping[str, list[float]] | None:
        """Take the blocks that are over and return all differences by kind; None where they can't be read."""
        asked = select(RolloutBlock).where(
            RolloutBlock.rollout == rollout.number, RolloutBlock.wave == wave.wave
        )
        blocks = list(session.scalars(asked.order_by(RolloutBlock.begin_utc)))
        rigs = who_compares(session, wave, utc)
        try:
            for begin_utc in due(wave, [block.begin_utc for block in blocks], utc):
                taken = [take_block(wave, kind, own, begin_utc, self._costs) for kind, own in rigs.items()]
                session.add_all(taken)
                blocks += taken
        except DataError as error:  # judged when the numbers are there again
            self.problem = str(error)
            return None
        known = {kind: [block for block in blocks if block.kind == kind] for kind in rigs}
        return {
            kind: [block.difference for block in own if block.difference is not None]
            for kind, own in known.items()
        }

    def _send(self, utc: float) -> None:
        """Send each order that is due, and note which could be sent."""
        waiting = (RigState.ORDERED, RigState.ROLLING_BACK)
        with Session(self._engine) as session, session.begin():
            self._check(session)  # first: what is sent can't be taken back
            asked = (
                select(RolloutRig, BundleRollout)
                .join(BundleRollout, RolloutRig.rollout == BundleRollout.number)
                .where(RolloutRig.state.in_(waiting), RolloutRig.sent_utc <= utc - AGAIN_S)
            )
            for row, rollout in session.execute(asked).all():
                if row.state == RigState.ORDERED:
                    sent = self._line.install(
                        row.rig, archive_url(self._address, rollout.sha256), rollout.sha256
                    )
                else:
                    sent = self._line.roll_back(row.rig, rollout.version)
                row.sent_utc = utc if sent else row.sent_utc


def _hold_people_off(session: Session, rollout: BundleRollout, wave: RolloutWave | None) -> None:
    """Let nobody else decide about a rollout until the end of the look. Errors: DecidedMeanwhile"""
    before = wave and wave.state
    lock(session, rollout.number)
    if wave is not None:
        session.refresh(wave)
    if (rollout.state, wave and wave.state) != (RolloutState.RUNNING, before):
        raise DecidedMeanwhile


def _kinds(
    session: Session, rollout: BundleRollout, reached: set[str], there_utc: float | None
) -> dict[str, KindRigs]:
    """Return the rigs of a rollout by kind; those that wait are there at a time where so asked."""
    found: dict[str, list[FleetRig]] = {}
    for rig in session.scalars(select(FleetRig).order_by(FleetRig.name)):
        if not rollout.group or rig.group == rollout.group:
            found.setdefault(rig.kind, []).append(rig)
    return {
        kind: KindRigs(
            len(rigs),
            [
                rig.name
                for rig in rigs
                if rig.name not in reached and (there_utc is None or rig.is_there(there_utc))
            ],
        )
        for kind, rigs in found.items()
    }
