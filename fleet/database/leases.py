"""Which process does a work that one alone may do."""

from sqlalchemy import BigInteger, String
from sqlalchemy.orm import Mapped, mapped_column

from fleet.database.base import FleetTable
from fleet.database.rigs import NAME_MAX

MACHINE_MAX = 128


class WorkLease(FleetTable):
    """A work and its holder. beat : rises while the holder lives

    holder : drawn anew for each, "" for nobody; machine : where its pid is one; host : a name for people
    """

    __tablename__ = "leases"
    work: Mapped[str] = mapped_column(String(NAME_MAX), primary_key=True)
    holder: Mapped[str] = mapped_column(String(NAME_MAX))
    machine: Mapped[str] = mapped_column(String(MACHINE_MAX))
    host: Mapped[str] = mapped_column(String(MACHINE_MAX))
    pid: Mapped[int] = mapped_column(BigInteger)
    beat: Mapped[int] = mapped_column(BigInteger)
