"""Names, documents and limits of a record's files.

start.json, then day-0001.json and day-0001.jsonl.gz for each UTC day, at last seal.json. Each JSON file has
its Ed25519 signature beside it (.sig), and each day names the SHA-256 of the JSON file before it.
"""

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from edge.bundle.archive import ArchiveLimits
from edge.bundle.manifest import Sha256
from edge.bundle.signature import SIGNATURE_BYTES, check_signature
from edge.core.errors import DataError
from edge.evidence.day_rows import SeqGap
from edge.formats.cross_check import Rule
from edge.formats.input_file import read_file
from edge.formats.reader import parse_json, read

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

LAYOUT = 1
START, SEAL, SIGNER = "start.json", "seal.json", "signer.pub"
DAY_S = 86400.0
DAYS_MAX = 1000
RECORD = ArchiveLimits("record", 3 * DAYS_MAX + 5, 32 << 20, 512 << 20)
ENTRY_BYTES = 1 << 20
DAY_NAME = re.compile(r"day-(\d{4})\.json")
Layout = Annotated[int, Rule(low=LAYOUT, high=LAYOUT)]
Day = Annotated[str, Rule(pattern=r"\d{4}-\d\d-\d\d", most=10)]
Count = Annotated[int, Rule(low=0)]
Entry = TypeVar("Entry")


@dataclass(frozen=True, slots=True)
class ChainStart:
    """start.json. date : of the start, UTC; after_seq : the newest tick before it; key_sha256 : the signer"""

    layout: Layout
    date: Day
    started_utc: float
    history_id: str
    after_seq: Count
    protocol_sha256: Sha256
    key_sha256: Sha256
    software: str


@dataclass(frozen=True, slots=True)
class ChainDay:
    """day-NNNN.json. marks : marks sealed so far, this day's included; gaps : numbers without a row"""

    layout: Layout
    number: Annotated[int, Rule(low=1, high=DAYS_MAX)]
    date: Day
    previous_sha256: Sha256
    rows_sha256: Sha256
    rows_bytes: Count
    history_id: str
    after_seq: Count
    last_seq: Count
    ticks: Count
    gaps: tuple[SeqGap, ...]
    marks: Count
    sealed_utc: float


@dataclass(frozen=True, slots=True)
class ChainSeal:
    """seal.json: the end of the record as it was handed over. head_sha256 : of the last day's JSON file"""

    layout: Layout
    days: Count
    head_sha256: Sha256
    sealed_utc: float


def day_name(number: int) -> str:
    """Return the name of a day's entry."""
    return f"day-{number:04d}.json"


def rows_name(number: int) -> str:
    """Return the name of a day's rows."""
    return f"day-{number:04d}.jsonl.gz"


def signature_name(name: str) -> str:
    """Return the name of the signature of start.json, a day or seal.json."""
    return name.removesuffix(".json") + ".sig"


def day_numbers(folder: Path) -> list[int]:
    """Return the numbers of the days whose entries are in the folder, ascending."""
    return sorted(int(match[1]) for path in folder.iterdir() if (match := DAY_NAME.fullmatch(path.name)))


def date_of(utc: float) -> date:
    """Return the UTC day of a moment. Errors: DataError where no calendar has it"""
    try:
        return datetime.fromtimestamp(utc, UTC).date()
    except (ValueError, OverflowError, OSError) as error:
        raise DataError(f"{utc:g} s after 1970 is not a time") from error


def begin_of(day: str) -> float:
    """Return the begin of a UTC day [s since 1970]. Errors: DataError"""
    try:
        return datetime.fromisoformat(f"{day}T00:00:00+00:00").timestamp()
    except ValueError as error:
        raise DataError(f"{day} is not a day") from error


def next_day(day: str) -> str:
    """Return the date of the day after. Errors: DataError"""
    try:
        return str(date.fromisoformat(day) + timedelta(1))
    except (ValueError, OverflowError) as error:
        raise DataError(f"{day} is not a day that another one follows") from error


def read_part(folder: Path, name: str, most: int = ENTRY_BYTES) -> bytes:
    """Return a file of the record. Errors: DataError, which names it"""
    try:
        return read_file(folder / name, most)
    except FileNotFoundError as error:
        raise DataError(f"{name} is missing") from error
    except OSError as error:
        raise DataError(f"{name}: {error.strerror or error}") from error


def read_entry(kind: type[Entry], folder: Path, name: str, key: "Ed25519PublicKey") -> tuple[Entry, str]:
    """Return a signed entry and its SHA-256. Errors: DataError, which names the file"""
    content = read_part(folder, name)
    with naming(signature_name(name)):
        signature = read_part(folder, signature_name(name), SIGNATURE_BYTES)
        check_signature(content, signature, {SIGNER: key})
    return read(kind, parse_json(content, name), name), sha256(content)


def sha256(content: bytes) -> str:
    """Return the digest in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Errors begin with the place, where they do not name it yet. Errors: DataError"""
    try:
        yield
    except DataError as error:
        text = str(error)
        raise DataError(text if text.startswith(place) else f"{place}: {text}") from error
