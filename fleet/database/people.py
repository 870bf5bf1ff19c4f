"""People who log in, their role in each group, and their sessions."""

from sqlalchemy import Float, ForeignKey, LargeBinary, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

BROWSER_MAX = 200  # characters


class FleetPerson(FleetTable):
    """Somebody with a password: its salt and its scrypt."""

    __tablename__ = "people"
    name: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    salt: Mapped[bytes] = mapped_column(LargeBinary)
    password: Mapped[bytes] = mapped_column(LargeBinary)


class FleetRight(FleetTable):
    """The role of a person in a group, "*" for all groups. role : a value of `edge.page.access.Role`"""

    __tablename__ = "rights"
    person: Mapped[str] = mapped_column(ForeignKey("people.name", ondelete="CASCADE"), primary_key=True)
    group: Mapped[str] = mapped_column("group_name", String(NAME_MAX), primary_key=True)
    role: Mapped[int]


class FleetSession(FleetTable):
    """A browser in which somebody has logged in; times in seconds since 1970. secret : its SHA-256"""

    __tablename__ = "sessions"
    id: Mapped[int] = mapped_column(primary_key=True)
    secret: Mapped[bytes] = mapped_column(LargeBinary(32), unique=True)
    person: Mapped[str] = mapped_column(ForeignKey("people.name", ondelete="CASCADE"), index=True)
    browser: Mapped[str] = mapped_column(String(BROWSER_MAX))
    made_utc: Mapped[float] = mapped_column(Float)
    seen_utc: Mapped[float] = mapped_column(Float)
    expires_utc: Mapped[float] = mapped_column(Float)
