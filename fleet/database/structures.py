"""Twins of boxes in structures that others of their kind have told, and what these tell of a new box."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable

STRUCTURE_MAX = 255


class StructureFit(FleetTable):
    """A box's twin with other effects than it has told, fitted to its numbers in store.

    structure : names of the effects, joined by +; told_sha256 : of the twin that it had told then
    document : of a twin file
    """

    __tablename__ = "structure_fits"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    structure: Mapped[str] = mapped_column(String(STRUCTURE_MAX), primary_key=True)
    told_sha256: Mapped[str] = mapped_column(String(64))
    utc: Mapped[float]
    document: Mapped[dict[str, Any]] = mapped_column(JSON)


class BoxRehearsal(FleetTable):
    """A box as if it were new, by the others of its kind in a structure.

    structure : as in StructureFit; told_sha256 : of what the kind's boxes had told then
    missed_k, loss_share : of `fleet.priors.rehearsal.Rehearsal`
    """

    __tablename__ = "hour_rehearsals"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.name"), primary_key=True)
    structure: Mapped[str] = mapped_column(String(STRUCTURE_MAX), primary_key=True)
    told_sha256: Mapped[str] = mapped_column(String(64))
    utc: Mapped[float]
    missed_k: Mapped[float]
    loss_share: Mapped[float]
