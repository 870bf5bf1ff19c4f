"""Alarms that vmalert has posted, who has seen them, and orders that people have given through the fleet."""

from sqlalchemy import String, Text
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

TEXT_MAX = 500  # characters


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
