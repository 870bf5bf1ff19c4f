"""Record of a store's installs: the newest version, and the bundles that have proved their models."""

import re
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from edge.bundle.manifest import Sha256
from edge.formats.cross_check import REQUIRED
from edge.formats.reader import read
from edge.formats.state_document import read_document, write_document

FILE = "admitted.json"
PROVED_MAX = 64  # the newest ones; a bundle that falls out is proved again when it is loaded
_RELEASE = re.compile(r"\d{1,9}(?:\.\d{1,9})*")


@dataclass(frozen=True, slots=True)
class Admission:
    """newest : version of the newest bundle, by number; "" before the first; proved : sha256 of manifests."""

    newest: str = field(default="", metadata=REQUIRED)
    proved: tuple[Sha256, ...] = field(default=(), metadata=REQUIRED)

    def with_install(self, version: str, manifest_sha256: str) -> "Admission":
        """Return the record after an install. An older bundle that the operator
        allowed sets `newest` back.
        """
        others = tuple(sha256 for sha256 in self.proved if sha256 != manifest_sha256)
        return replace(self, newest=version, proved=(*others, manifest_sha256)[-PROVED_MAX:])


def release(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, for comparisons: (2,) for "2.0-twin-3f2a", () without any."""
    found = _RELEASE.match(version)
    numbers = [int(part) for part in found[0].split(".")] if found else []
    while numbers and numbers[-1] == 0:  # 2.0 is 2
        numbers.pop()
    return tuple(numbers)


def read_admission(folder: Path) -> Admission | None:
    """Read the store's record, None where there is none. Errors: DataError"""
    path = folder / FILE
    values = read_document(path)
    if values is None:
        return None
    return read(Admission, values, str(path))


def write_admission(folder: Path, admitted: Admission) -> None:
    """Replace the record. Errors: OSError"""
    write_document(folder / FILE, asdict(admitted))
