"""The newest twin that a rig has told."""

from typing import Any

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from fleet.database.twins import ToldTwin

Json = dict[str, Any]


def known_twin(engine: Engine, rig: str) -> Json | None:
    """Return its bundle, its time and the effects of its document, None before the rig has told any."""
    with Session(engine) as session:
        twin = session.get(ToldTwin, rig)
        if twin is None:
            return None
        return {"bundle": twin.bundle, "utc": twin.utc, "effects": twin.document.get("effects") or {}}
