"""The twins that rigs told, what the fleet has learnt of them, and the boxes that are unlike their kind."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

EFFECT_MAX = 64


class ToldTwin(FleetTable):
    """The twin that runs on a rig, as it told it last. document : of a twin file, without its origin"""

    __tablename__ = "told_twins"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    bundle: Mapped[str] = mapped_column(String(NAME_MAX))
    utc: Mapped[float]
    document: Mapped[dict[str, Any]] = mapped_column(JSON)


class KeptPrior(FleetTable):
    """A prior of the twins that were told at a time; the newest counts. boxes : that told it"""

    __tablename__ = "priors"
    utc: Mapped[float] = mapped_column(primary_key=True)
    boxes: Mapped[int]
    document: Mapped[dict[str, Any]] = mapped_column(JSON)


class Departure(FleetTable):
    """A value of a rig's twin that is far from its kind's.

    ratio : to what is usual for the kind; spreads : between them, of the kind's
    """

    __tablename__ = "departures"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    effect: Mapped[str] = mapped_column(String(EFFECT_MAX), primary_key=True)
    parameter: Mapped[str] = mapped_column(String(EFFECT_MAX), primary_key=True)
    ratio: Mapped[float]
    spreads: Mapped[float]
    since_utc: Mapped[float]
