"""The proof of a record: signer, order, completeness, nothing changed. Read as if an enemy had made it."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from edge.bundle.archive import unpack
from edge.bundle.signature import fingerprint, read_public_key
from edge.core.errors import DataError
from edge.evidence.chain_files import (
    DAY_S,
    RECORD,
    SEAL,
    SIGNER,
    START,
    ChainDay,
    ChainSeal,
    ChainStart,
    begin_of,
    day_name,
    day_numbers,
    naming,
    next_day,
    read_entry,
    read_part,
    rows_name,
    sha256,
    signature_name,
)
from edge.evidence.day_rows import SealedRow, missing_numbers, read_rows
from edge.formats.input_file import MemoryFile, open_file

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey


SeeRow = Callable[[ChainDay, SealedRow], None]


@dataclass(frozen=True, slots=True)
class ProvenRecord:
    """A record whose proof holds. signer : SHA-256 of the key; heads : SHA-256 of start and days, in order"""

    signer: str
    start: ChainStart
    days: tuple[ChainDay, ...]
    seal: ChainSeal
    heads: tuple[str, ...]

    @property
    def missing(self) -> int:
        """Tick numbers without a row."""
        return sum(gap.last_seq - gap.first_seq + 1 for day in self.days for gap in day.gaps)


def open_record(
    archive: Path, key: Path | None = None, heads: Sequence[str] = (), see: SeeRow = lambda day, row: None
) -> ProvenRecord:
    """Unpack and prove an archive.

    key : public key that must have signed it; heads : published SHA-256s that must be in its chain
    see : is given every line, with its day; what it has seen counts only when this returns
    Errors : DataError, which names archive and place
    """
    with tempfile.TemporaryDirectory(prefix="record-") as temporary, naming(str(archive)):
        folder = Path(temporary)
        try:
            with open_file(archive) as file:
                unpack(file, folder, RECORD)
        except OSError as error:
            raise DataError(error.strerror or str(error)) from error
        return _prove(folder, key, heads, see)


def _prove(folder: Path, key: Path | None, heads: Sequence[str], see: SeeRow) -> ProvenRecord:
    """Prove an unpacked record. Errors: DataError, which names the first file that does not hold"""
    public = read_public_key(MemoryFile(Path(SIGNER), read_part(folder, SIGNER)))
    signer = fingerprint(public)
    if key is not None and fingerprint(read_public_key(key)) != signer:
        raise DataError(f"{SIGNER}: the record is signed by another key than {key}: by {signer}")
    start, head = read_entry(ChainStart, folder, START, public)
    if start.key_sha256 != signer:
        raise DataError(f"{START}: names the key {start.key_sha256} as the signer, not the one of {SIGNER}")
    seal, _ = read_entry(ChainSeal, folder, SEAL, public)
    _check_names(folder, seal)
    days, chain = _prove_days(folder, public, seal, start, head, see)
    if seal.head_sha256 != chain[-1]:
        raise DataError(f"{SEAL}: names another last entry than {day_name(seal.days) if days else START}")
    if seal.sealed_utc < (days[-1].sealed_utc if days else start.started_utc):
        raise DataError(f"{SEAL}: sealed before the last entry was")
    for published in heads:
        if published.lower() not in chain:
            raise DataError(f"the published head {published} is not in this chain")
    return ProvenRecord(signer, start, days, seal, chain)


def _check_names(folder: Path, seal: ChainSeal) -> None:
    """Refuse missing days and files that no entry names. Errors: DataError"""
    numbers = range(1, seal.days + 1)
    if missing := sorted(set(numbers) - set(day_numbers(folder))):
        raise DataError(f"{day_name(missing[0])} is missing: {SEAL} counts {seal.days} days")
    signed = [START, SEAL, *(day_name(number) for number in numbers)]
    known = {SIGNER, *signed, *map(signature_name, signed), *map(rows_name, numbers)}
    if unknown := sorted({path.name for path in folder.iterdir()} - known):
        raise DataError(f"{unknown[0]} does not belong into this record: {SEAL} counts {seal.days} days")


def _prove_days(
    folder: Path, public: "Ed25519PublicKey", seal: ChainSeal, start: ChainStart, head: str, see: SeeRow
) -> tuple[tuple[ChainDay, ...], tuple[str, ...]]:
    """Return the days and the SHA-256s of start and days, proved one after the other."""
    days: list[ChainDay] = []
    chain = [head]
    date, after, marks = start.date, start.after_seq, 0
    history_id, sealed_utc = start.history_id, start.started_utc
    for number in range(1, seal.days + 1):
        name = day_name(number)
        day, own = read_entry(ChainDay, folder, name, public)
        with naming(name):
            if day.number != number or day.date != date:
                raise DataError(f"is of day {day.number}, {day.date}, and stands for {number}, {date}")
            if day.previous_sha256 != chain[-1]:
                raise DataError("names another entry before it: the order or the entry before was changed")
            if day.sealed_utc < max(sealed_utc, begin_of(date) + DAY_S):
                raise DataError("was sealed before its day was over, or before the entry before it")
            if day.after_seq != after and (day.history_id == history_id or day.after_seq != 0):
                raise DataError(f"begins after tick {day.after_seq}, and tick {after} was sealed last")
            _prove_rows(folder, day, marks, see)
        days.append(day)
        chain.append(own)
        date, after, marks = next_day(date), day.last_seq, day.marks
        history_id, sealed_utc = day.history_id, day.sealed_utc
    return tuple(days), tuple(chain)


def _prove_rows(folder: Path, day: ChainDay, marks_before: int, see: SeeRow) -> None:
    """Hold a day's rows to its entry. Errors: DataError"""
    name = rows_name(day.number)
    packed = read_part(folder, name, RECORD.file_bytes)
    if sha256(packed) != day.rows_sha256:
        raise DataError(f"{name}: changed after it was sealed: its SHA-256 is not the one of its entry")
    seqs: list[int] = []
    marks = 0
    for row in read_rows(packed, name):
        see(day, row)
        marks += row.mark is not None
        if row.tick is not None:
            if row.tick.seq <= (seqs[-1] if seqs else day.after_seq) or row.tick.seq > day.last_seq:
                raise DataError(f"{name}: tick {row.tick.seq} is out of order")
            seqs.append(row.tick.seq)
    if len(seqs) != day.ticks or marks != day.marks - marks_before:
        raise DataError(f"{name}: holds {len(seqs)} ticks and {marks} marks, not the numbers of its entry")
    listed = [(gap.first_seq, gap.last_seq) for gap in day.gaps]
    if listed != missing_numbers(seqs, day.after_seq, day.last_seq):
        raise DataError(f"{name}: tick numbers are missing that its entry does not list")
