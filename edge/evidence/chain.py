"""A rig's record while it grows: started once, extended by whole UTC days, each signed and chained.

A day's rows and signature are on the disk before its entry, and the entry makes the day: a kill between two
writes leaves a day that is made anew.
"""

import json
import platform
import sqlite3
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge.bundle.archive import pack
from edge.bundle.manifest import MANIFEST, PACKAGED
from edge.bundle.sign import read_private_key
from edge.bundle.signature import fingerprint
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.config.loading import config_hash
from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.core.version import __version__
from edge.evidence.chain_files import (
    DAY_S,
    LAYOUT,
    RECORD,
    SEAL,
    SIGNER,
    START,
    ChainDay,
    ChainSeal,
    ChainStart,
    begin_of,
    date_of,
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
from edge.evidence.day_rows import collect_day
from edge.evidence.marks import read_marks
from edge.evidence.protocol import protocol_sha256
from edge.formats.atomic_file import hold_lock, write_atomically
from edge.formats.input_file import SMALL, read_text
from edge.storage.run_rows import reading

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

LOCK = ".lock"
GRACE_S = 600.0  # after midnight, so that the history's writer is done with the day
CATCH_UP_DAYS = 40  # a clock that claims more is wrong rather than late


def start_chain(folder: Path, history: Path, key_file: Path, now_utc: float) -> ChainStart:
    """Begin a record: its start names the newest tick, the signer and the protocol's numbers.

    Errors : RequestError where one has begun; DataError for a bad key or history
    """
    key = read_private_key(key_file)
    with hold_lock(folder / LOCK):
        if (folder / START).exists():
            raise RequestError(f"{folder}: a record has begun here already")
        with reading(history) as connection:
            history_id, newest = _identity(connection)
        start = ChainStart(
            layout=LAYOUT,
            date=str(date_of(now_utc)),
            started_utc=now_utc,
            history_id=history_id,
            after_seq=newest,
            protocol_sha256=protocol_sha256(),
            key_sha256=fingerprint(key.public_key()),
            software=__version__,
        )
        write_atomically(folder / SIGNER, _public_pem(key))
        _write_entry(folder, START, start, key)
    return start


def extend_chain(
    folder: Path, history: Path, key_file: Path, facts: Mapping[str, Any], now_utc: float
) -> tuple[list[ChainDay], str]:
    """Seal every UTC day that is over and not sealed; return these days and the head.

    facts : what is known of the rig now: settings, bundle, software
    Errors : RequestError without a start or with a clock that cannot be right; DataError
    """
    key = read_private_key(key_file)
    added: list[ChainDay] = []
    with hold_lock(folder / LOCK):
        before, head = last_entry(folder, key)
        date = before.date if isinstance(before, ChainStart) else next_day(before.date)
        if now_utc - begin_of(date) > CATCH_UP_DAYS * DAY_S:
            raise RequestError(f"{date} is next and the clock says {date_of(now_utc)}: is the clock right?")
        while begin_of(date) + DAY_S + GRACE_S <= now_utc:
            before, head = _add_day(folder, history, key, facts, before, head, date, now_utc)
            added.append(before)
            date = next_day(date)
    return added, head


def last_entry(folder: Path, key: "Ed25519PrivateKey") -> tuple[ChainStart | ChainDay, str]:
    """Return the newest entry and its SHA-256. Errors: RequestError without a start; DataError"""
    if not (folder / START).exists():
        raise RequestError(f"{folder}: no record has begun; `greenhouse evidence start` begins one")
    public = key.public_key()
    with naming(str(folder)):
        start, head = read_entry(ChainStart, folder, START, public)
        numbers = day_numbers(folder)
        if not numbers:
            return start, head
        return read_entry(ChainDay, folder, day_name(numbers[-1]), public)


def seal_chain(folder: Path, key_file: Path, out: Path, now_utc: float) -> ChainSeal:
    """Write start, days and a signed end into one archive; the record goes on. Errors: DataError, OSError"""
    key = read_private_key(key_file)
    with hold_lock(folder / LOCK), tempfile.TemporaryDirectory(prefix="record-") as temporary:
        last, head = last_entry(folder, key)
        days = 0 if isinstance(last, ChainStart) else last.number
        names = [SIGNER, START, *(day_name(number) for number in range(1, days + 1))]
        names += [signature_name(name) for name in names[1:]]
        names += [rows_name(number) for number in range(1, days + 1)]
        copy = Path(temporary)
        for name in names:
            (copy / name).write_bytes(read_part(folder, name, RECORD.file_bytes))
        seal = ChainSeal(LAYOUT, days, head, now_utc)
        _write_entry(copy, SEAL, seal, key)
        write_atomically(out, pack(copy, RECORD))
    return seal


def _add_day(
    folder: Path,
    history: Path,
    key: "Ed25519PrivateKey",
    facts: Mapping[str, Any],
    before: ChainStart | ChainDay,
    head: str,
    date: str,
    now_utc: float,
) -> tuple[ChainDay, str]:
    """Write the day after `before`; return it and its SHA-256."""
    number, after, marks_before = (
        (1, before.after_seq, 0)
        if isinstance(before, ChainStart)
        else (before.number + 1, before.last_seq, before.marks)
    )
    end_utc = begin_of(date) + DAY_S
    new_marks = [mark for mark in read_marks(folder)[marks_before:] if mark.utc < end_utc]
    with reading(history) as connection:
        history_id, newest = _identity(connection)
        if history_id != before.history_id and newest < after:
            after = 0  # a new history that counts from 1: nothing of it is sealed yet
        link = connection.execute(
            "SELECT text FROM events WHERE key = 'board.link_up' ORDER BY seq DESC LIMIT 1"
        ).fetchone()
        known = {**facts, "board": link[0] if link else ""}
        rows = collect_day(connection, after, end_utc, known, new_marks)
    if len(rows.packed) > RECORD.file_bytes:
        raise DataError(f"{date}: {len(rows.packed)} bytes are more than a day may have, {RECORD.file_bytes}")
    day = ChainDay(
        layout=LAYOUT,
        number=number,
        date=date,
        previous_sha256=head,
        rows_sha256=sha256(rows.packed),
        rows_bytes=len(rows.packed),
        history_id=history_id,
        after_seq=after,
        last_seq=rows.last_seq,
        ticks=rows.ticks,
        gaps=rows.gaps,
        marks=marks_before + len(new_marks),
        sealed_utc=now_utc,
    )
    write_atomically(folder / rows_name(number), rows.packed)
    return day, _write_entry(folder, day_name(number), day, key)


def _identity(connection: sqlite3.Connection) -> tuple[str, int]:
    """Return the history's id and its newest tick."""
    (history_id,) = connection.execute("SELECT id FROM history").fetchone()
    (newest,) = connection.execute("SELECT coalesce(max(seq), 0) FROM ticks WHERE seq > 0").fetchone()
    return history_id, newest


def _write_entry(folder: Path, name: str, entry: Any, key: "Ed25519PrivateKey") -> str:
    content = json.dumps(asdict(entry), indent=1, ensure_ascii=False).encode()
    write_atomically(folder / signature_name(name), key.sign(content))
    write_atomically(folder / name, content)
    return sha256(content)


def _public_pem(key: "Ed25519PrivateKey") -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def rig_facts(config: Path, settings: Settings, store: BundleStore) -> dict[str, Any]:
    """Return plain values. A file that cannot be read is a fact too."""
    files = {path.name: _file_text(path) for path in (config, config.parent / "board.yaml") if path.exists()}
    return {
        "software": __version__,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {platform.system()} {platform.release()}",
        "config_sha256": config_hash(settings),
        "bundle": _bundle(store),
        "files": files,
    }


def _file_text(path: Path) -> str:
    try:
        return read_text(path, SMALL >> 2)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _bundle(store: BundleStore) -> str:
    """Return the active bundle and the SHA-256 of its manifest."""
    try:
        active = store.roles().active
        folder = PACKAGED_FOLDER if active == PACKAGED else store.folder_of(active)
        return f"{active}, manifest {sha256((folder / MANIFEST).read_bytes())}"
    except (DataError, OSError) as error:
        return f"cannot be read: {error}"
