"""All that a rig needs to go on elsewhere in one file, from configuration and keys to history and evidence.

The file is a tar with gzip. Its first member, manifest.json, names every other one with its SHA-256; the
others have names of their role, not of their path, so that a machine with other paths can take them.
"""

import hashlib
import json
import os
import re
import shutil
import socket
import sqlite3
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from edge.app.box import BEFORE
from edge.config import loading
from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.core.version import __version__
from edge.formats.atomic_file import make_folder, move, sync_folder
from edge.formats.cross_check import Rule
from edge.formats.reader import parse_json, read

MANIFEST, LAYOUT = "manifest.json", 1
CONFIG, HISTORY, STATE, PAGE = "edge.yaml", "history.db", "state.json", "page.db"
DATABASES = (HISTORY, PAGE)
BESIDE_A_DATABASE = ("-wal", "-shm", "-journal")  # of the old one; beside a new one they would spoil it
COPIES = 3  # of a folder that changes while it is read
_NAME = re.compile(r"[\w.+-]+(/[\w.+-]+)*", re.ASCII)
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class BackupManifest:
    """The manifest. files : SHA-256 by name; version : of the software that wrote it"""

    layout: Annotated[int, Rule(low=LAYOUT, high=LAYOUT)]
    version: str
    created_utc: str
    files: Mapping[str, str] = field(default_factory=dict)


def read_manifest(content: bytes | str, place: str = MANIFEST) -> BackupManifest:
    """Return the manifest of a backup. Errors: DataError"""
    return read(BackupManifest, parse_json(content, place, most=_CHUNK), place)


def places(config: Path, settings: Settings) -> dict[str, Path]:
    """Return files and folders of a rig by their name in a backup."""
    bundle = settings.bundle
    found = {
        CONFIG: config,
        "board.yaml": config.parent / "board.yaml",
        "twin.yaml": config.parent / "twin.yaml",
        f"twin.yaml{BEFORE}": config.parent / f"twin.yaml{BEFORE}",
        "credentials": config.parent / "credentials",
        "page-credentials": config.parent / "page-credentials",
        "keys": Path(bundle.trusted_keys),
        "signing.key": Path(bundle.signing_key) if bundle.signing_key else None,
        "bundles": Path(bundle.path) if bundle.path else None,
        "diagnosis": Path(settings.drift.reports),
        HISTORY: Path(settings.history.path),
        "evidence": settings.history.evidence,
        STATE: Path(settings.state_file),
        PAGE: Path(settings.page.folder) / PAGE,
    }
    return {name: path for name, path in found.items() if path is not None}


def back_up(config: Path, out: Path) -> dict[str, int]:
    """Write a backup, readable by its owner alone, while the daemon runs or not; return bytes by name.

    Errors : ConfigError, DataError for a history that cannot be read, OSError
    """
    settings = loading.load(config)
    with tempfile.TemporaryDirectory(prefix=".backup-", dir=out.absolute().parent) as name:
        folder = Path(name) / "files"
        folder.mkdir()
        sizes = {
            part: _copy(part, path, folder / part)
            for part, path in places(config, settings).items()
            if path.exists()
        }
        draft = Path(name) / "backup"
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            _write(file, folder)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(out)
        sync_folder(out.absolute().parent)
    return sizes


def _copy(part: str, path: Path, target: Path) -> int:
    """Copy one file, folder or database as it is at one moment; return its bytes."""
    if part in DATABASES:
        try:
            with (
                closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as source,
                closing(sqlite3.connect(target)) as copy,
            ):
                source.backup(copy)
        except sqlite3.Error as error:
            raise DataError(f"{path}: {error}") from error
        target.chmod(path.stat().st_mode & 0o777)
    elif path.is_dir():
        _copy_folder(path, target)
    else:
        shutil.copy2(path, target)
    files = [target] if target.is_file() else [file for file in target.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files)


def _copy_folder(path: Path, target: Path) -> None:
    """Copy a folder again where a file went while it was read, as when a bundle is installed."""
    for left in range(COPIES - 1, -1, -1):
        try:
            shutil.copytree(path, target)
            return
        except (shutil.Error, FileNotFoundError):
            shutil.rmtree(target, ignore_errors=True)
            if not left:
                raise


def _write(file: object, folder: Path) -> None:
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    manifest = {
        "layout": LAYOUT,
        "version": __version__,
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "files": {name: _digest(folder / name) for name in names},
    }
    first = folder / MANIFEST
    first.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
    with tarfile.open(fileobj=file, mode="w:gz") as archive:  # type: ignore[call-overload]
        for name in (MANIFEST, *names):
            archive.add(folder / name, name)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def restore(backup: Path, config: Path, replaces: bool) -> Iterator[str]:
    """Put everything of a backup in its place; yield a line for each.

    The places are those that the configuration in the backup names; that itself goes to `config`.
    What stands there already is refused, or kept beside under another name with `replaces`.

    Errors : DataError for a damaged file, nothing is written then; RequestError while the daemon runs
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=_existing(config.absolute().parent)) as name:
        folder = Path(name)
        _unpack(backup, folder)
        settings = loading.load(folder / CONFIG)
        _refuse_while_it_runs(settings)
        every = places(config, settings)
        found = {part: path for part, path in every.items() if (folder / part).exists()}
        taken = [str(path) for path in found.values() if path.exists()]
        if taken and not replaces:
            raise RequestError(f"already there: {', '.join(taken)}; --replace keeps them under another name")
        for part, path in found.items():
            kept = _put(folder / part, path, stamp)
            yield f"{path}{f' (before: {kept})' if kept else ''}"


def _existing(folder: Path) -> Path:
    return folder if folder.is_dir() else _existing(folder.parent)


def _unpack(backup: Path, folder: Path) -> None:
    """Unpack what the manifest names, and check each file. Errors: DataError"""
    try:
        with tarfile.open(backup, "r:gz") as archive:
            first = archive.next()
            stream = archive.extractfile(first) if first is not None and first.name == MANIFEST else None
            if stream is None:
                raise DataError(f"{backup}: not a backup: its first member is not {MANIFEST}")
            manifest = read_manifest(stream.read(_CHUNK), f"{backup}: {MANIFEST}")
            while (member := archive.next()) is not None:
                _unpack_file(archive, member, manifest, folder, backup)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise DataError(f"{backup}: {error}") from error
    missing = [name for name in manifest.files if not (folder / name).is_file()]
    if missing or CONFIG not in manifest.files:
        raise DataError(f"{backup}: incomplete: {', '.join(missing) or CONFIG} is missing")


def _unpack_file(
    archive: tarfile.TarFile, member: tarfile.TarInfo, manifest: BackupManifest, folder: Path, backup: Path
) -> None:
    parts = Path(member.name).parts
    is_plain = _NAME.fullmatch(member.name) is not None and not {".", ".."} & set(parts)
    if member.name not in manifest.files or not member.isfile() or not is_plain:
        raise DataError(f"{backup}: {member.name!r} does not belong into a backup")
    target = folder / member.name
    target.parent.mkdir(parents=True, exist_ok=True)
    stream = archive.extractfile(member)
    assert stream is not None
    with target.open("wb") as file:
        shutil.copyfileobj(stream, file, _CHUNK)
    target.chmod(member.mode & 0o777)
    if _digest(target) != manifest.files[member.name]:
        raise DataError(f"{backup}: {member.name} is damaged: its SHA-256 is another one")


def _refuse_while_it_runs(settings: Settings) -> None:
    with closing(socket.socket(socket.AF_UNIX)) as probe, suppress(OSError):
        probe.connect(settings.control_socket.path)
        raise RequestError("the daemon runs; `systemctl stop greenhouse` first")


def _put(source: Path, path: Path, stamp: str) -> Path | None:
    """Move a file or folder into its place; return where the one before is."""
    make_folder(path.parent)
    owner = path.parent.stat()
    draft = path.with_name(f".{path.name}.restored")
    if draft.is_dir():
        shutil.rmtree(draft)
    if source.is_dir():
        shutil.copytree(source, draft)
    else:
        shutil.copy2(source, draft)
    for item in (draft, *draft.rglob("*")):
        with suppress(PermissionError):  # whoever is not root owns it already
            os.chown(item, owner.st_uid, owner.st_gid)
    kept = path.with_name(f"{path.name}.before-{stamp}") if path.exists() else None
    if kept is not None:
        move(path, kept)
    for ending in BESIDE_A_DATABASE if source.name in DATABASES else ():
        beside = path.with_name(path.name + ending)
        if beside.exists():
            move(beside, path.with_name(f"{path.name}.before-{stamp}{ending}"))
    move(draft, path)
    return kept
