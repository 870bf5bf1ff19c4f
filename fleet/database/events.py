"""Events of rigs, and what rigs sent that was refused."""

from sqlalchemy import BigInteger, ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

WORD_MAX = 16


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
