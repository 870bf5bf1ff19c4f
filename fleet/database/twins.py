"""The twins that rigs told, and diagnoses of rigs whose twins no longer agree."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

VERDICT_MAX = 32


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
