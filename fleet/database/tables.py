"""Every table of the fleet, each declared once. Times in seconds since 1970."""

from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    ColumnElement,
    Float,
    ForeignKey,
    Index,
    LargeBinary,
    String,
    Text,
    and_,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

NAME_MAX = 64
SILENT_S = 600.0  # without a word: a rig is away then, whatever it said last
WORD_MAX = 16
SHA256_CHARS, STATE_CHARS = 64, 16
VERDICT_MAX = 32
TEXT_MAX = 500  # characters
BROWSER_MAX = 200  # characters
MACHINE_MAX = 128


class FleetTable(DeclarativeBase):
    """Root of every table."""


class TableVersion(FleetTable):
    """One row: the version that made the tables."""

    __tablename__ = "table_version"
    version: Mapped[int] = mapped_column(primary_key=True)


class FleetRig(FleetTable):
    """A rig.

    group : whose people may see it; kind : boxes that are built alike share one, "" where nobody said
    is_online : as it or its last will has said; a broker that was killed delivers none, so see `is_there`
    state : the newest payload of its topic `state`, {} before the first
    """

    __tablename__ = "rigs"
    name: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    group: Mapped[str] = mapped_column("group_name", String(NAME_MAX), default="", index=True)
    kind: Mapped[str] = mapped_column(String(NAME_MAX), default="", index=True)
    first_utc: Mapped[float]
    last_utc: Mapped[float]
    is_online: Mapped[bool] = mapped_column(default=False)
    state: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)

    def is_there(self, utc: float) -> bool:
        """Return whether it is online at a time, by its word and by the age of its last one."""
        return self.is_online and utc - self.last_utc < SILENT_S


def are_there(utc: float) -> ColumnElement[bool]:
    """Return the condition that chooses rigs by `FleetRig.is_there`."""
    return and_(FleetRig.is_online, FleetRig.last_utc > utc - SILENT_S)


class StoredSpan(FleetTable):
    """Ticks of one history of a rig that are in store, both ends included; spans never touch."""

    __tablename__ = "stored_spans"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    history_id: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    first_seq: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    last_seq: Mapped[int] = mapped_column(BigInteger)


class AbsentSpan(FleetTable):
    """Ticks of one history that will not come: the rig has said so, or they were refused."""

    __tablename__ = "absent_spans"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    history_id: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    first_seq: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    last_seq: Mapped[int] = mapped_column(BigInteger)


class RigEvent(FleetTable):
    """An event of a stored tick.

    number : its place among the tick's events; utc : the tick's where the event has none
    """

    __tablename__ = "rig_events"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    history_id: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    utc: Mapped[float]
    key: Mapped[str] = mapped_column(String(NAME_MAX))
    severity: Mapped[str] = mapped_column(String(WORD_MAX))
    text: Mapped[str] = mapped_column(Text)
    __table_args__ = (Index("rig_events_by_utc", "utc"),)


class Refusal(FleetTable):
    """Messages of a rig that were not believed: one row a reason, however many they were.

    rig : "" for those that are of no rig that is known; text : what was wrong with the newest
    """

    __tablename__ = "refusals"
    rig: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    reason: Mapped[str] = mapped_column(String(WORD_MAX), primary_key=True)
    count: Mapped[int] = mapped_column(BigInteger, default=0)
    first_utc: Mapped[float]
    last_utc: Mapped[float]
    text: Mapped[str] = mapped_column(Text, default="")


class FleetBundle(FleetTable):
    """A signed archive. sha256 : of the archive; created_utc : as its manifest says"""

    __tablename__ = "bundles"
    sha256: Mapped[str] = mapped_column(String(SHA256_CHARS), primary_key=True)
    version: Mapped[str] = mapped_column(String(NAME_MAX), index=True)
    name: Mapped[str] = mapped_column(String(NAME_MAX))
    created_utc: Mapped[str] = mapped_column(String(NAME_MAX))
    added_utc: Mapped[float]
    archive: Mapped[bytes] = mapped_column(LargeBinary, deferred=True)


class BundleRollout(FleetTable):
    """A bundle on its way to all rigs of a group.

    group : "" for the whole fleet; state : a value of `fleet.rollout.states.RolloutState`
    wave : the present one, from 1; 0 before the first; why : the reason of its end
    margin, error, wave_h : the settings with which it began; a change of them does not move its bounds
    """

    __tablename__ = "rollouts"
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    sha256: Mapped[str] = mapped_column(ForeignKey("bundles.sha256"))
    version: Mapped[str] = mapped_column(String(NAME_MAX))
    group: Mapped[str] = mapped_column("group_name", String(NAME_MAX), default="")
    state: Mapped[str] = mapped_column(String(STATE_CHARS), index=True)
    wave: Mapped[int] = mapped_column(default=0)
    margin: Mapped[float]
    error: Mapped[float]
    wave_h: Mapped[float]
    began_utc: Mapped[float]
    ended_utc: Mapped[float | None] = mapped_column(default=None)
    why: Mapped[str] = mapped_column(Text, default="")


class RolloutWave(FleetTable):
    """A wave. judged_from_utc : begin of its first block; kinds : figures of the last look, by kind"""

    __tablename__ = "rollout_waves"
    rollout: Mapped[int] = mapped_column(ForeignKey("rollouts.number"), primary_key=True)
    wave: Mapped[int] = mapped_column(primary_key=True)
    state: Mapped[str] = mapped_column(String(STATE_CHARS))
    began_utc: Mapped[float]
    judged_from_utc: Mapped[float | None] = mapped_column(default=None)
    ended_utc: Mapped[float | None] = mapped_column(default=None)
    why: Mapped[str] = mapped_column(Text, default="")
    kinds: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)


class RolloutRig(FleetTable):
    """A rig that a rollout has reached.

    state : a value of `fleet.rollout.states.RigState`, since since_utc; sent_utc : of the newest order
    fault : key of the event that tells of harm, "" without one; offline_utc : since when it is away
    """

    __tablename__ = "rollout_rigs"
    rollout: Mapped[int] = mapped_column(ForeignKey("rollouts.number"), primary_key=True)
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    kind: Mapped[str] = mapped_column(String(NAME_MAX))
    wave: Mapped[int]
    state: Mapped[str] = mapped_column(String(STATE_CHARS), index=True)
    since_utc: Mapped[float]
    sent_utc: Mapped[float] = mapped_column(default=0.0)
    offline_utc: Mapped[float | None] = mapped_column(default=None)
    fault: Mapped[str] = mapped_column(String(NAME_MAX), default="")
    fault_utc: Mapped[float | None] = mapped_column(default=None)
    why: Mapped[str] = mapped_column(Text, default="")


class RolloutBlock(FleetTable):
    """A block of hours of a kind, judged once: late ticks do not change it.

    difference : as `fleet.rollout.judge.difference`, None where nothing could be compared
    changed, waiting : boxes that were compared
    """

    __tablename__ = "rollout_blocks"
    rollout: Mapped[int] = mapped_column(ForeignKey("rollouts.number"), primary_key=True)
    wave: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    begin_utc: Mapped[float] = mapped_column(primary_key=True)
    difference: Mapped[float | None] = mapped_column(default=None)
    changed: Mapped[int]
    waiting: Mapped[int]


class ToldTwin(FleetTable):
    """The twin that runs on a rig, as it told it last. document : of a twin file, without its origin"""

    __tablename__ = "told_twins"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    bundle: Mapped[str] = mapped_column(String(NAME_MAX))
    utc: Mapped[float]
    document: Mapped[dict[str, Any]] = mapped_column(JSON)


class RigDiagnosis(FleetTable):
    """A diagnosis of a rig.

    utc : of the newest tick that it has seen; since_utc : when the rig began to disagree
    verdict : of diagnosis.json, "failed" where there was none; text : it in a sentence
    effects : those that are named; before_k, after_k : errors of free runs over rows that no fit saw [K]
    """

    __tablename__ = "diagnoses"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    since_utc: Mapped[float] = mapped_column(primary_key=True)
    utc: Mapped[float]
    verdict: Mapped[str] = mapped_column(String(VERDICT_MAX))
    text: Mapped[str] = mapped_column(Text)
    effects: Mapped[list[Any]] = mapped_column(JSON, default=list)
    before_k: Mapped[float | None]
    after_k: Mapped[float | None]


class FleetAlarm(FleetTable):
    """An alarm of a rig, from its begin to its end; times in seconds since 1970.

    rig : "" for one of the whole fleet; last_utc : when vmalert has said so last
    ended_utc : None while it lasts
    """

    __tablename__ = "alarms"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(NAME_MAX))
    rig: Mapped[str] = mapped_column(String(NAME_MAX), index=True)
    severity: Mapped[str] = mapped_column(String(NAME_MAX))
    text: Mapped[str] = mapped_column(String(TEXT_MAX))
    first_utc: Mapped[float] = mapped_column(index=True)
    last_utc: Mapped[float]
    ended_utc: Mapped[float | None] = mapped_column(index=True)
    seen_by: Mapped[str | None] = mapped_column(String(NAME_MAX))


class FleetOrder(FleetTable):
    """An order to a rig, written before it is sent. answer : the rig's, or why none came; None until then"""

    __tablename__ = "orders"
    id: Mapped[int] = mapped_column(primary_key=True)
    rig: Mapped[str] = mapped_column(String(NAME_MAX), index=True)
    person: Mapped[str] = mapped_column(String(NAME_MAX))
    utc: Mapped[float]
    what: Mapped[str] = mapped_column(String(NAME_MAX))
    payload: Mapped[str] = mapped_column(Text)
    answer: Mapped[str | None] = mapped_column(Text)


class FleetPerson(FleetTable):
    """Somebody with a password: its salt and its scrypt."""

    __tablename__ = "people"
    name: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    salt: Mapped[bytes] = mapped_column(LargeBinary)
    password: Mapped[bytes] = mapped_column(LargeBinary)


class FleetRight(FleetTable):
    """The role of a person in a group, "*" for all groups. role : a value of `edge.page.access.Role`"""

    __tablename__ = "rights"
    person: Mapped[str] = mapped_column(ForeignKey("people.name", ondelete="CASCADE"), primary_key=True)
    group: Mapped[str] = mapped_column("group_name", String(NAME_MAX), primary_key=True)
    role: Mapped[int]


class FleetSession(FleetTable):
    """A browser in which somebody has logged in; times in seconds since 1970. secret : its SHA-256"""

    __tablename__ = "sessions"
    id: Mapped[int] = mapped_column(primary_key=True)
    secret: Mapped[bytes] = mapped_column(LargeBinary(32), unique=True)
    person: Mapped[str] = mapped_column(ForeignKey("people.name", ondelete="CASCADE"), index=True)
    browser: Mapped[str] = mapped_column(String(BROWSER_MAX))
    made_utc: Mapped[float] = mapped_column(Float)
    seen_utc: Mapped[float] = mapped_column(Float)
    expires_utc: Mapped[float] = mapped_column(Float)


class WorkLease(FleetTable):
    """A work and its holder. beat : rises while the holder lives

    holder : drawn anew for each, "" for nobody; machine : where its pid is one; host : a name for people
    """

    __tablename__ = "leases"
    work: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    holder: Mapped[str] = mapped_column(String(NAME_MAX))
    machine: Mapped[str] = mapped_column(String(MACHINE_MAX))
    host: Mapped[str] = mapped_column(String(MACHINE_MAX))
    pid: Mapped[int] = mapped_column(BigInteger)
    beat: Mapped[int] = mapped_column(BigInteger)
