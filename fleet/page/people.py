"""People and their sessions: added, listed, removed, logged in; the role that each has in a group."""

import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from edge.core.errors import RequestError
from edge.core.plain_text import plain
from edge.page.access import SEEN_EVERY_S, SESSION_S, Role
from edge.page.secret_hashes import NOBODY, hash_secret, is_password, new_password, person_name
from fleet.database.tables import BROWSER_MAX, FleetPerson, FleetRight, FleetSession

EVERY = "*"  # group: all of them, and the rigs that have none


@dataclass(frozen=True, slots=True)
class FleetVisitor:
    """Somebody who has a session. rights : their role by group, EVERY for all groups"""

    session: int
    name: str
    rights: Mapping[str, Role]

    def role(self, group: str) -> Role | None:
        """Return their role over rigs of a group, None without any."""
        return max((self.rights[name] for name in (group, EVERY) if name in self.rights), default=None)

    @property
    def groups(self) -> frozenset[str] | None:
        """The groups that they may see, None for all."""
        return None if EVERY in self.rights else frozenset(self.rights)


@dataclass(frozen=True, slots=True)
class People:
    """All who may log in. Every method is thread-safe."""

    engine: Engine
    utc: Callable[[], float] = time.time

    def add(self, name: str, group: str, role: Role, password: str | None) -> None:
        """Give somebody a role in a group; a new password ends the sessions that they had.

        password : None leaves the one that they have
        Errors : RequestError for a password that is too short, or missing for somebody new
        """
        name = person_name(name)
        hashed = None if password is None else new_password(password)
        with Session(self.engine) as session, session.begin():
            person = session.get(FleetPerson, name)
            if hashed is not None:
                session.execute(delete(FleetSession).where(FleetSession.person == name))
                session.merge(FleetPerson(name=name, salt=hashed[0], password=hashed[1]))
                session.flush()
            elif person is None:
                raise RequestError(f"{name} has no password yet")
            session.merge(FleetRight(person=name, group=group, role=int(role)))

    def remove(self, name: str, group: str | None = None) -> None:
        """Take a person's role in a group away, or the person. Errors: RequestError where there is none"""
        with Session(self.engine) as session, session.begin():
            whose = [FleetRight.person == name] + ([] if group is None else [FleetRight.group == group])
            removed = session.execute(delete(FleetRight).where(*whose))
            if not removed.rowcount:  # type: ignore[attr-defined]  # a DELETE has one
                raise RequestError(f"{name} has no role{'' if group is None else f' in group {group}'}")
            if session.scalars(select(FleetRight).where(FleetRight.person == name)).first() is None:
                session.execute(delete(FleetSession).where(FleetSession.person == name))
                session.execute(delete(FleetPerson).where(FleetPerson.name == name))

    def rights(self) -> list[tuple[str, str, Role]]:
        """Return name, group and role of each right."""
        query = select(FleetRight).order_by(FleetRight.person, FleetRight.group)
        with Session(self.engine) as session:
            return [(right.person, right.group, Role(right.role)) for right in session.scalars(query)]

    def log_in(self, name: str, password: str, browser: str) -> tuple[str, FleetVisitor] | None:
        """Begin a session; returns its secret, None where name or password is wrong."""
        with Session(self.engine) as session:
            person = session.get(FleetPerson, name)
        salt, known = NOBODY if person is None else (person.salt, person.password)
        if not is_password(password, salt, known):
            return None
        secret, now = secrets.token_urlsafe(32), self.utc()
        with Session(self.engine) as session, session.begin():
            session.execute(delete(FleetSession).where(FleetSession.expires_utc < now))
            begun = FleetSession(
                secret=hash_secret(secret),
                person=name,
                browser=plain(browser, BROWSER_MAX),
                made_utc=now,
                seen_utc=now,
                expires_utc=now + SESSION_S,
            )
            session.add(begun)
            session.flush()
            return secret, FleetVisitor(begun.id, name, _rights(session, name))

    def visitor(self, secret: str) -> FleetVisitor | None:
        """Return whose session it is, None where there is none or it has ended."""
        now = self.utc()
        query = select(FleetSession).where(
            FleetSession.secret == hash_secret(secret), FleetSession.expires_utc > now
        )
        with Session(self.engine) as session, session.begin():
            found = session.scalars(query).first()
            if found is None:
                return None
            if now - found.seen_utc > SEEN_EVERY_S:
                found.seen_utc, found.expires_utc = now, now + SESSION_S
            return FleetVisitor(found.id, found.person, _rights(session, found.person))

    def end_session(self, number: int) -> bool:
        """End a session; returns whether there was one."""
        with Session(self.engine) as session, session.begin():
            ended = session.execute(delete(FleetSession).where(FleetSession.id == number))
            return bool(ended.rowcount)  # type: ignore[attr-defined]  # as above

    def sessions(self) -> list[dict[str, object]]:
        """Return those that have not ended, the newest visit first; times in seconds since 1970."""
        query = select(FleetSession).where(FleetSession.expires_utc > self.utc())
        with Session(self.engine) as session:
            return [
                {"session": row.id, "name": row.person, "browser": row.browser, "seen_utc": row.seen_utc}
                for row in session.scalars(query.order_by(FleetSession.seen_utc.desc()))
            ]


def _rights(session: Session, name: str) -> dict[str, Role]:
    query = select(FleetRight).where(FleetRight.person == name)
    return {right.group: Role(right.role) for right in session.scalars(query)}
