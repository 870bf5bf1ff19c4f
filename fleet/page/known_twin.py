"""The newest twin that a rig has told, and where it is unlike its kind."""

from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from fleet.database.twins import Departure, ToldTwin

Json = dict[str, Any]


def known_twin(engine: Engine, rig: str) -> Json | None:
    """Return its bundle, time, effects and departures, None before the rig has told any.

    effects : of the twin's document; departures : each with its ratio to what is usual for the kind
    """
    query = select(Departure).where(Departure.rig == rig).order_by(Departure.effect, Departure.parameter)
    with Session(engine) as session:
        twin = session.get(ToldTwin, rig)
        if twin is None:
            return None
        departures = [
            {key: getattr(row, key) for key in ("effect", "parameter", "ratio", "spreads", "since_utc")}
            for row in session.scalars(query)
        ]
        effects = twin.document.get("effects") or {}
        return {"bundle": twin.bundle, "utc": twin.utc, "effects": effects, "departures": departures}
