"""The twins that rigs told."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX


class ToldTwin(FleetTable):
    """The twin that runs on a rig, as it told it last. document : of a twin file, without its origin"""

    __tablename__ = "told_twins"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    bundle: Mapped[str] = mapped_column(String(NAME_MAX))
    utc: Mapped[float]
    document: Mapped[dict[str, Any]] = mapped_column(JSON)
