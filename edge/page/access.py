"""Who may do what: links, sessions and passwords, in a SQLite file of the page's own; the role of orders."""

import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.formats.atomic_file import make_folder
from edge.formats.owner import as_owner, open_database
from edge.page.secret_hashes import hash_secret, is_password, new_password, person_name

DAY_S = 86_400.0
LINK_DAYS_MAX = 366.0
SESSION_S = 30 * DAY_S  # without a visit, after which a session ends
SEEN_EVERY_S = 600.0  # a visit is written no more often: a card wears
BUSY_S = 5.0
SCHEMA = """
CREATE TABLE IF NOT EXISTS links (id INTEGER PRIMARY KEY AUTOINCREMENT, secret BLOB UNIQUE, role INTEGER,
    name TEXT, made_utc REAL, expires_utc REAL, uses_left INTEGER);
CREATE TABLE IF NOT EXISTS sessions (id INTEGER PRIMARY KEY AUTOINCREMENT, secret BLOB UNIQUE, link INTEGER,
    role INTEGER, name TEXT, browser TEXT, made_utc REAL, seen_utc REAL, expires_utc REAL);
CREATE TABLE IF NOT EXISTS people (name TEXT PRIMARY KEY, role INTEGER, salt BLOB, password BLOB);
CREATE TABLE IF NOT EXISTS facts (key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS acknowledged (seq INTEGER, number INTEGER, name TEXT, utc REAL,
    PRIMARY KEY (seq, number)) WITHOUT ROWID;
"""


RIGHTS = {"sessions": "id", "links": "id", "people": "name"}  # that can be taken back, by their key


class Role(IntEnum):
    """The rights of a visitor; each may do what those below it may. All may stop the rig."""

    VIEW = 1
    OPERATE = 2
    ADMIN = 3

    @property
    def word(self) -> str:
        """Return its name as people write it."""
        return self.name.lower()


ROLES = {role.word: role for role in Role}


@dataclass(frozen=True, slots=True)
class Visitor:
    """Who has a session. name : as the history shows it next to their orders; link : 0 without one"""

    session: int
    name: str
    role: Role
    link: int = 0


@dataclass(frozen=True, slots=True)
class Access:
    """The file at `path`, made when it is first written to. All methods are thread-safe; Errors: DataError"""

    path: Path
    utc: Callable[[], float] = time.time

    @classmethod
    def of(cls, folder: str | Path) -> Self:
        """Return the file of a page's folder."""
        return cls(Path(folder) / "page.db")

    def make_link(self, role: Role, name: str, valid_s: float, uses: int | None = 1) -> str:
        """Return the secret of a new link. uses : how many may enter by it, None for any number"""
        secret, now = secrets.token_urlsafe(32), self.utc()
        with self._writing() as db:
            db.execute(
                "INSERT INTO links (secret, role, name, made_utc, expires_utc, uses_left)"
                " VALUES (?, ?, ?, ?, ?, ?)",
                (hash_secret(secret), role, person_name(name), now, now + valid_s, uses),
            )
        return secret

    def enter(self, secret: str, browser: str) -> tuple[str, Visitor] | None:
        """Begin a session by a link; None where there is no such link, or no longer.

        A session of a link for many ends with the link, one of a link for once when it is not used any more.
        """
        now = self.utc()
        with self._writing() as db:
            found = db.execute(
                "SELECT id, role, name, expires_utc, uses_left FROM links WHERE secret = ?"
                " AND expires_utc > ? AND (uses_left IS NULL OR uses_left > 0)",
                (hash_secret(secret), now),
            ).fetchone()
            if found is None:
                return None
            link, role, name, expires_utc, uses_left = found
            db.execute("UPDATE links SET uses_left = uses_left - 1 WHERE id = ?", (link,))
            until_utc = expires_utc if uses_left is None else now + SESSION_S
            return self._begin(db, link, Role(role), name, browser, until_utc)

    def log_in(self, name: str, password: str, browser: str) -> tuple[str, Visitor] | None:
        """Begin a session by a password; None where name or password is wrong."""
        with self._writing() as db:
            found = db.execute("SELECT role, salt, password FROM people WHERE name = ?", (name,)).fetchone()
        if found is None or not is_password(password, *found[1:]):
            return None
        role = found[0]
        with self._writing() as db:
            return self._begin(db, None, Role(role), name, browser, self.utc() + SESSION_S)

    def set_password(self, name: str, role: Role, password: str) -> None:
        """Let a person log in; sessions that they had under another password end. Errors: RequestError"""
        salt, hashed = new_password(password)
        with self._writing() as db:
            db.execute("DELETE FROM sessions WHERE name = ? AND link IS NULL", (person_name(name),))
            row = (person_name(name), role, salt, hashed)
            db.execute("INSERT OR REPLACE INTO people VALUES (?, ?, ?, ?)", row)

    def visitor(self, secret: str) -> Visitor | None:
        """Return whose session it is, None where there is none or it has ended."""
        now = self.utc()
        with self._reading() as db:
            found = db.execute(
                "SELECT id, name, role, seen_utc, link FROM sessions WHERE secret = ? AND expires_utc > ?",
                (hash_secret(secret), now),
            ).fetchone()
        if found is None:
            return None
        session, name, role, seen_utc, link = found
        if now - seen_utc > SEEN_EVERY_S:
            self._note_visit(session, link, now)
        return Visitor(session, name, Role(role), link or 0)

    def sessions(self) -> list[dict[str, object]]:
        """Return those that have not ended, the newest visit first; times in seconds since 1970."""
        with self._reading() as db:
            rows = db.execute(
                "SELECT id, name, role, browser, made_utc, seen_utc, expires_utc, link FROM sessions"
                " WHERE expires_utc > ? ORDER BY seen_utc DESC",
                (self.utc(),),
            ).fetchall()
        keys = ("session", "name", "role", "browser", "made_utc", "seen_utc", "expires_utc", "link")
        return [dict(zip(keys, row, strict=True)) | {"role": Role(row[2]).word} for row in rows]

    def links(self) -> list[dict[str, object]]:
        """Return the links by which somebody may enter, or has a session; times in seconds since 1970."""
        with self._reading() as db:
            rows = db.execute(
                "SELECT id, name, role, made_utc, expires_utc, uses_left FROM links WHERE"
                " (expires_utc > ? AND (uses_left IS NULL OR uses_left > 0))"
                " OR id IN (SELECT link FROM sessions WHERE expires_utc > ?) ORDER BY id DESC",
                (self.utc(), self.utc()),
            ).fetchall()
        keys = ("link", "name", "role", "made_utc", "expires_utc", "uses_left")
        return [dict(zip(keys, row, strict=True)) | {"role": Role(row[2]).word} for row in rows]

    def people(self) -> list[dict[str, object]]:
        """Return who logs in by name."""
        with self._reading() as db:
            rows = db.execute("SELECT name, role FROM people ORDER BY name").fetchall()
        return [{"name": name, "role": Role(role).word} for name, role in rows]

    def revoke(self, kind: str, key: int | str) -> list[int]:
        """End a session, a link with its sessions, or a person's password with theirs.

        kind : a key of RIGHTS
        Returns : the sessions that ended
        """
        of_it = {"sessions": "id = ?", "links": "link = ?", "people": "link IS NULL AND name = ?"}[kind]
        with self._writing() as db:
            ended = db.execute(f"DELETE FROM sessions WHERE {of_it} RETURNING id", (key,)).fetchall()
            db.execute(f"DELETE FROM {kind} WHERE {RIGHTS[kind]} = ?", (key,))
        return [row[0] for row in ended]

    def revoke_all(self) -> list[int]:
        """End all sessions and links; passwords stay. Return the sessions."""
        with self._writing() as db:
            db.execute("DELETE FROM links")
            return [row[0] for row in db.execute("DELETE FROM sessions RETURNING id").fetchall()]

    def role_of(self, kind: str, key: int | str) -> Role | None:
        """Return the role of a session, link or person; None where there is none.

        kind : a key of RIGHTS
        """
        with self._reading() as db:
            found = db.execute(f"SELECT role FROM {kind} WHERE {RIGHTS[kind]} = ?", (key,)).fetchone()
        return None if found is None else Role(found[0])

    def acknowledge(self, seq: int, number: int, name: str) -> None:
        """Note who has seen an alarm: event `number` of tick `seq`. The first one stays."""
        with self._writing() as db:
            row = (seq, number, name, self.utc())
            db.execute("INSERT OR IGNORE INTO acknowledged VALUES (?, ?, ?, ?)", row)

    def who_acknowledged(self, first_seq: int, since_utc: float = 0.0) -> dict[tuple[int, int], str]:
        """Return who has seen which event of tick `first_seq` or later, and has said so after `since_utc`."""
        query = "SELECT seq, number, name FROM acknowledged WHERE seq >= ? AND utc >= ?"
        with self._reading() as db:
            rows = db.execute(query, (first_seq, since_utc))
            return {(seq, number): name for seq, number, name in rows}

    def open_to_network(self) -> None:
        """Note that the page shall listen to other machines."""
        self.set_fact("network", "1")

    @property
    def is_open_to_network(self) -> bool:
        """Somebody has called `greenhouse page pair`."""
        return self.fact("network") is not None

    def fact(self, key: str) -> str | None:
        """Return a text that the page or a command has left under a name, None where there is none."""
        with self._reading() as db:
            found = db.execute("SELECT value FROM facts WHERE key = ?", (key,)).fetchone()
            return None if found is None else str(found[0])

    def set_fact(self, key: str, value: str | None) -> None:
        """Leave a text under a name, or None to remove it."""
        with self._writing() as db:
            if value is None:
                db.execute("DELETE FROM facts WHERE key = ?", (key,))
            else:
                db.execute("INSERT OR REPLACE INTO facts VALUES (?, ?)", (key, value))

    def _begin(
        self, db: sqlite3.Connection, link: int | None, role: Role, name: str, browser: str, until_utc: float
    ) -> tuple[str, Visitor]:
        secret, now = secrets.token_urlsafe(32), self.utc()
        row = (hash_secret(secret), link, role, name, plain(browser, 200), now, now, until_utc)
        cursor = db.execute(
            "INSERT INTO sessions (secret, link, role, name, browser, made_utc, seen_utc, expires_utc)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            row,
        )
        assert cursor.lastrowid is not None
        return secret, Visitor(cursor.lastrowid, name, role, link or 0)

    def _note_visit(self, session: int, link: int | None, now: float) -> None:
        """Prolong a session, but not past the end of a link for many."""
        with self._writing() as db:
            many = db.execute("SELECT 1 FROM links WHERE id = ? AND uses_left IS NULL", (link,)).fetchone()
            db.execute("UPDATE sessions SET seen_utc = ? WHERE id = ?", (now, session))
            if many is None:
                db.execute("UPDATE sessions SET expires_utc = ? WHERE id = ?", (now + SESSION_S, session))

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        try:
            if not self.path.parent.is_dir():
                make_folder(self.path.parent)
                self.path.parent.chmod(0o700)
            with (
                as_owner(self.path),
                closing(open_database(self.path, timeout=BUSY_S, isolation_level=None)) as db,
            ):
                self.path.chmod(0o600)
                db.executescript(SCHEMA)
                db.execute("BEGIN IMMEDIATE")
                with db:  # commits, or rolls back
                    yield db
        except (sqlite3.Error, OSError) as error:
            raise DataError(f"{self.path}: {error}") from error

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        try:
            if not self.path.exists():
                with self._writing():
                    pass
            with closing(open_database(self.path, timeout=BUSY_S)) as db:
                yield db
        except (sqlite3.Error, OSError) as error:
            raise DataError(f"{self.path}: {error}") from error


NEEDS = {  # request of the control socket -> role; what is not in the list is not passed on
    "emergency_stop": Role.VIEW,  # whoever sees that something is wrong may stop it
    "release_emergency_stop": Role.OPERATE,
    "clear_trip": Role.OPERATE,
    "maintenance": Role.OPERATE,
    "set_mode": Role.OPERATE,
    "set_fan_mode": Role.OPERATE,
    "set_reference": Role.OPERATE,
    "set_controller": Role.OPERATE,
    "set_manual": Role.OPERATE,
    "start_profile": Role.OPERATE,
    "pause_profile": Role.OPERATE,
    "resume_profile": Role.OPERATE,
    "skip_profile": Role.OPERATE,
    "end_profile": Role.OPERATE,
    "calibrate_point": Role.OPERATE,
    "discard_points": Role.OPERATE,
    "apply_calibration": Role.OPERATE,
    "reset_calibration": Role.OPERATE,
    "ask": Role.OPERATE,
    "proposal": Role.OPERATE,
    "confirm": Role.OPERATE,
    "discard": Role.OPERATE,
    "undo": Role.OPERATE,
    "memory": Role.OPERATE,
    "remember": Role.OPERATE,
    "forget": Role.OPERATE,
    "bundle": Role.ADMIN,
    "adopt": Role.ADMIN,
}


def order_problem(order: Mapping[str, Any], role: Role) -> str:
    """Return why a visitor of this role may not give an order, "" where they may."""
    kind = order.get("do")
    needed = NEEDS.get(kind) if isinstance(kind, str) else None
    if needed is None:
        return f"do: one of {', '.join(NEEDS)}"
    return "" if role >= needed else f"{kind} needs the role {needed.word}, yours is {role.word}"
