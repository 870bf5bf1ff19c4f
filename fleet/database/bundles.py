"""Bundles that a fleet has, their rollouts in waves, which rig got which one, and why a rollout ended."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, LargeBinary, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

SHA256_CHARS, STATE_CHARS = 64, 16


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
