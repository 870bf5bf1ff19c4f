"""The rigs as the page lists them, worst first: of some groups, kinds or standings, or by part of a name."""

import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine, Row, select
from sqlalchemy.orm import Session

from fleet.database.tables import FleetRig
from fleet.page.standing import RigFinding, Standing, find, number_of

Json = dict[str, Any]
Drifts = Mapping[str, Mapping[str, Any]]

FRESH_S = 2.0  # all who look share one reading of the table
READING_SHARE = 0.1  # of the time at most: tens of thousands of rigs are read less often
SHOWN_MAX = 500
# Not whole objects, which take as long again.
COLUMNS = (
    FleetRig.name,
    FleetRig.group,
    FleetRig.kind,
    FleetRig.last_utc,
    FleetRig.is_online,
    FleetRig.state,
)


@dataclass(frozen=True, slots=True)
class ListedRig:
    """A rig with its standing. state : the newest payload of its topic"""

    name: str
    group: str
    kind: str
    last_utc: float
    state: Mapping[str, Any]
    drift: Mapping[str, Any]
    finding: RigFinding

    def row(self) -> Json:
        """Return its line of the list; a number that is not known is null."""
        return {
            "name": self.name,
            "group": self.group,
            "kind": self.kind,
            "standing": self.finding.standing.word,
            "why": self.finding.why,
            "last_utc": self.last_utc or None,
            **{key: number_of(self.state, key) for key in ("temp_air_c", "reference_c", "heater_duty")},
        }


@dataclass(frozen=True, slots=True)
class Wanted:
    """The rigs to list. groups : those that somebody may see, None for all; "" : any"""

    groups: frozenset[str] | None = None
    group: str = ""
    kind: str = ""
    standing: Standing | None = None
    search: str = ""

    def may_see(self, rig: ListedRig) -> bool:
        """Return whether a rig is one that they may see."""
        return self.groups is None or rig.group in self.groups

    def holds(self, rig: ListedRig) -> bool:
        """Return whether it is one of those looked for, whatever its standing."""
        words = f"{rig.name} {rig.group} {rig.kind}".lower()
        return (
            self.group in ("", rig.group)
            and self.kind in ("", rig.kind)
            and all(word in words for word in self.search.lower().split())
        )


class RigList:
    """Reads the rigs. Every method is thread-safe."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._rigs: list[ListedRig] = []
        self._stale_s = float("-inf")

    def listing(self, wanted: Wanted, drifts: Drifts, now_utc: float) -> Json:
        """Return the rigs that are wanted, the worst first, and how many there are by standing."""
        seen = [rig for rig in self._all(drifts, now_utc) if wanted.may_see(rig)]
        found = [rig for rig in seen if wanted.holds(rig)]
        shown = [rig for rig in found if wanted.standing in (None, rig.finding.standing)]
        counts = Counter(rig.finding.standing for rig in found)
        return {
            "rigs": [rig.row() for rig in shown[:SHOWN_MAX]],
            "left_off": max(0, len(shown) - SHOWN_MAX),
            "counts": {standing.word: counts[standing] for standing in Standing},
            "groups": sorted({rig.group for rig in seen if rig.group}),
            "kinds": sorted({rig.kind for rig in seen if rig.kind}),
        }

    def rig(self, name: str, drifts: Drifts, now_utc: float) -> ListedRig | None:
        """Return a rig as it is in the table now."""
        with Session(self._engine) as session:
            row = session.execute(select(*COLUMNS).where(FleetRig.name == name)).first()
            return None if row is None else _rig_of(row, drifts, now_utc)

    def _all(self, drifts: Drifts, now_utc: float) -> list[ListedRig]:
        with self._lock:
            begin_s = time.monotonic()
            if begin_s > self._stale_s:
                with Session(self._engine) as session:
                    rigs = [_rig_of(row, drifts, now_utc) for row in session.execute(select(*COLUMNS))]
                self._rigs = sorted(rigs, key=lambda rig: (rig.finding.standing, rig.name))
                end_s = time.monotonic()
                self._stale_s = end_s + max(FRESH_S, (end_s - begin_s) / READING_SHARE)
            return self._rigs


def _rig_of(row: Row[Any], drifts: Drifts, now_utc: float) -> ListedRig:
    drift = drifts.get(row.name, {})
    finding = find(row.state, drift, row.is_online, row.last_utc, now_utc)
    return ListedRig(row.name, row.group, row.kind, row.last_utc, row.state, drift, finding)
