"""The rigs that were ever heard, and which of their ticks are in store."""

from typing import Any

from sqlalchemy import JSON, BigInteger, ColumnElement, ForeignKey, String, and_
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable

NAME_MAX = 64
SILENT_S = 600.0  # without a word: a rig is away then, whatever it said last


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
