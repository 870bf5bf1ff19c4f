"""The boxes of a fleet with the twins that they have told."""

import hashlib
import json
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from edge.twin.draws import correlations, uncertain
from edge.twin.twin_file import twin_of
from fleet.database.rigs import FleetRig
from fleet.database.twins import ToldTwin
from fleet.priors.fleet_prior import BoxSheet


@dataclass(frozen=True, slots=True)
class ToldSheets:
    """The boxes, the newest told first.

    sha256 : of the twin that each has told, by rig; unread : rigs whose twin cannot be read, with the reason
    """

    sheets: list[BoxSheet]
    sha256: dict[str, str]
    unread: dict[str, str]


def told_sheets(engine: Engine) -> ToldSheets:
    """Return what the database has."""
    with Session(engine) as session:
        wanted = select(ToldTwin, FleetRig.kind).join(FleetRig).order_by(ToldTwin.utc.desc(), ToldTwin.rig)
        told = session.execute(wanted).all()
    sheets, unread = [], {}
    for twin, kind in told:
        try:
            file = twin_of(twin.document)
            correlations(file, tuple(uncertain(file)))
            sheets.append(BoxSheet(twin.rig, kind, file))
        except DataError as error:
            unread[twin.rig] = str(error)
    # Not by when: a broker tells a kept twin again whenever somebody asks.
    return ToldSheets(sheets, {twin.rig: _sha256(twin.document) for twin, _ in told}, unread)


def _sha256(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
