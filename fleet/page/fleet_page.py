"""The state that all routes of the fleet's page share, and who asks."""

import time
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

import anyio
from sqlalchemy import Engine
from starlette.requests import Request

from edge.page.access import Role
from edge.page.answers import NotAllowed, in_thread
from edge.page.cookie import secret_of
from edge.page.password_tries import PasswordTries
from fleet.page.alarm_shelf import AlarmShelf
from fleet.page.order_desk import OrderDesk
from fleet.page.people import FleetVisitor, People
from fleet.page.rig_list import ListedRig, RigList
from fleet.rollout.overview import waiting_numbers
from fleet.settings import FleetSettings

ROW_MAX = 2**31 - 1  # the largest number of a row that PostgreSQL knows
COURSES_AT_ONCE = 4  # each keeps VictoriaMetrics busy
NO_RIG = "there is no such rig in your groups"  # the same for one of another group


@dataclass(slots=True)
class FleetPage:
    """The parts that all routes share. desk : None until the application runs"""

    settings: FleetSettings
    engine: Engine
    people: People
    alarms: AlarmShelf
    rigs: RigList
    alert_token: str
    desk: OrderDesk | None = None
    tries: PasswordTries = field(default_factory=PasswordTries)
    course_places: anyio.CapacityLimiter = field(
        default_factory=lambda: anyio.CapacityLimiter(COURSES_AT_ONCE)
    )

    async def visitor(self, request: Request) -> FleetVisitor:
        """Return who asks. Errors: NotAllowed"""
        secret = secret_of(request)
        found: FleetVisitor | None = await in_thread(self.people.visitor, secret) if secret else None
        if found is None:
            raise NotAllowed(HTTPStatus.UNAUTHORIZED, "no session: log in")
        return found

    async def rig(self, visitor: FleetVisitor, name: str) -> ListedRig:
        """Return a rig that somebody may see. Errors: NotAllowed"""
        drifts = {} if self.desk is None else self.desk.drifts
        found: ListedRig | None = await in_thread(self.rigs.rig, name, drifts, time.time())
        if found is None or visitor.role(found.group) is None:
            raise NotAllowed(HTTPStatus.NOT_FOUND, NO_RIG)
        return found

    async def health(self, visitor: FleetVisitor) -> dict[str, Any]:
        """Return what a visitor should know whatever they look at.

        broker : whether it answers; alarms_silent_s : since when nobody watches for alarms, None while
        somebody does; held : rollouts that wait for a person, by number
        """
        silence_s = self.alarms.silence
        return {
            "broker": self.desk is not None and self.desk.is_connected,
            "alarms_silent_s": None if silence_s is None else round(silence_s),
            "held": await in_thread(waiting_numbers, self.engine, visitor.groups),
        }


def row_number(request: Request, key: str = "number") -> int:
    """Return the number of a row in an address; no row has ROW_MAX, which stands for all beyond it."""
    return min(int(request.path_params[key]), ROW_MAX)


def refuse_below(needed: Role, own: Role | None) -> None:
    """Refuse somebody with less than a role. Errors: NotAllowed"""
    if own is None or own < needed:
        yours = "none" if own is None else own.word
        raise NotAllowed(HTTPStatus.FORBIDDEN, f"this needs the role {needed.word}, yours is {yours}")
