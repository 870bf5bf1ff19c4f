"""All that a rig needs to go on elsewhere in one file, from configuration and keys to history and evidence.

The file is a tar with gzip. Its first member, manifest.json, names every other one with its SHA-256; the
others have names of their role, not of their path, so that a machine with other paths can take them.
"""

import errno
import gzip
import hashlib
import json
import os
import re
import shutil
import sqlite3
import stat
import tarfile
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, BinaryIO

from edge.app.box import BEFORE
from edge.config import loading
from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.core.version import __version__
from edge.formats.atomic_file import make_folder, move, sync_folder
from edge.formats.cross_check import Rule
from edge.formats.input_file import SMALL, TABLE, open_file
from edge.formats.owner import COMPANIONS, as_owner, open_database
from edge.formats.reader import parse_json, read
from edge.sockets.client import listens

MANIFEST, LAYOUT = "manifest.json", 2
CONFIG, HISTORY, STATE, PAGE = "edge.yaml", "history.db", "state.json", "page.db"
DATABASES = (HISTORY, PAGE)
COPIES = 3  # of a folder that changes while it is read
# Where the package has its files: other places only where a configuration on this machine names them.
ETC, VAR, PAGE_FOLDER = Path("/etc/greenhouse"), Path("/var/lib/greenhouse"), Path("/var/lib/greenhouse-page")
_IN_ETC = (CONFIG, "board.yaml", "twin.yaml", "credentials", "page-credentials", "keys", "signing.key")
SECRETS = ("credentials", "page-credentials", "signing.key", PAGE)
SMALL_PARTS = (*_IN_ETC, STATE)
_LOOSE = stat.S_IRWXG | stat.S_IRWXO
UNPACKED_TIMES = 20  # of the backup's size; a history of numbers is packed to a quarter
_NAME = re.compile(r"[\w.+-]+(/[\w.+-]+)*", re.ASCII)
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class BackupManifest:
    """The manifest. files : SHA-256 by name; folders : mode by name; version : of what wrote it"""

    layout: Annotated[int, Rule(low=1, high=LAYOUT)]
    version: str
    created_utc: str
    files: Mapping[str, str] = field(default_factory=dict)
    folders: Mapping[str, int] = field(default_factory=dict)


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

    Errors : ConfigError; RequestError for a file that is there; OSError
        DataError for a history that cannot be read or a secret that others can
    """
    if os.path.lexists(out):
        raise RequestError(f"{out} exists; choose another name")
    found = places(config, loading.load(config))
    with tempfile.TemporaryDirectory(prefix=".backup-", dir=out.absolute().parent) as name:
        folder = Path(name) / "files"
        folder.mkdir()
        sizes = {part: _copy(part, path, folder / part) for part, path in found.items() if path.exists()}
        _refuse_loose(folder, found.__getitem__, ": `chmod go= {}`, then again")
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
        _copy_database(path, target)
    elif path.is_dir():
        _copy_folder(path, target)
    else:
        _save(open_file(path), target)
    return _bytes_of(target)


def _bytes_of(place: Path) -> int:
    files = [place] if place.is_file() else [file for file in place.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files)


def _copy_database(path: Path, target: Path) -> None:
    """Copy a database by way of its owner, who may neither see our folder nor lead us out of theirs."""
    with as_owner(path) as is_other:
        folder = path.parent if is_other else target.parent
        with tempfile.TemporaryDirectory(prefix=".backup-", dir=folder) as name:
            draft = Path(name) / path.name
            try:
                with (
                    closing(open_database(path, "mode=ro")) as source,
                    closing(open_database(draft)) as copy,
                ):
                    source.backup(copy)
            except sqlite3.Error as error:
                raise DataError(f"{path}: {error}") from error
            draft.chmod(path.stat().st_mode & 0o777)
            file = open_file(draft)
    _save(file, target)


def _save(file: BinaryIO, target: Path) -> None:
    with file, target.open("xb") as out:
        shutil.copyfileobj(file, out, _CHUNK)
        os.fchmod(out.fileno(), os.fstat(file.fileno()).st_mode & 0o777)


def _copy_folder(path: Path, target: Path) -> None:
    """Copy a folder again where a file went while it was read, as when a bundle is installed."""
    for left in range(COPIES - 1, -1, -1):
        try:
            _copy_folder_once(path, target)
            return
        except FileNotFoundError:
            shutil.rmtree(target, ignore_errors=True)
            if not left:
                raise


def _copy_folder_once(path: Path, target: Path) -> None:
    with as_owner(path / "x"):
        mode, entries = path.stat().st_mode & 0o777, sorted(path.iterdir())
        folders = {entry for entry in entries if entry.is_dir()}
    target.mkdir()
    for entry in entries:
        if entry in folders:
            _copy_folder_once(entry, target / entry.name)
        else:
            _save(open_file(entry), target / entry.name)
    target.chmod(mode)


def _refuse_loose(folder: Path, place_of: Callable[[str], Path], advice: str) -> None:
    """Refuse secrets that others than their owner can read. Errors: DataError with the advice for a place"""
    for part in SECRETS:
        top = folder / part
        if not top.exists() or (top.is_dir() and not top.stat().st_mode & _LOOSE):
            continue
        for path in (top, *top.rglob("*")):
            if path.is_file() and (mode := path.stat().st_mode & 0o777) & _LOOSE:
                place = place_of(part) / path.relative_to(top)
                setting = " (bundle.signing_key)" if part == "signing.key" else ""
                reason = f"can be read by other users (mode {mode:04o}){advice.format(place)}"
                raise DataError(f"{place}{setting} {reason}")


def _write(file: object, folder: Path) -> None:
    paths = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    manifest = {
        "layout": LAYOUT,
        "version": __version__,
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "files": {name: _digest(path) for name, path in paths.items() if path.is_file()},
        "folders": {name: path.stat().st_mode & 0o777 for name, path in paths.items() if path.is_dir()},
    }
    first = folder / MANIFEST
    first.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
    with tarfile.open(fileobj=file, mode="w:gz") as archive:  # type: ignore[call-overload]
        for name in (MANIFEST, *manifest["files"]):  # type: ignore[misc]
            archive.add(folder / name, name)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def restore(
    backup: Path, config: Path, replaces: bool, agrees: Callable[[list[str]], bool] = lambda lines: True
) -> Iterator[str]:
    """Put everything of a backup in its place; yield a line for each.

    The places are those of the package and of a configuration at `config`; the configuration in the backup
    decides only if it agrees. Existing files are refused; with `replaces` they stay under another name.

    agrees : sees every place with its size; nothing is written where it returns False
    Errors : DataError for a damaged file or another place, RequestError while the daemon runs or where
        `agrees` returns False: nothing is written then
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    above = next(folder for folder in config.absolute().parents if folder.is_dir())
    with tempfile.TemporaryDirectory(prefix=".restore-", dir=above) as name:
        folder = Path(name)
        _unpack(backup, folder)
        _refuse_loose(folder, lambda part: Path(f"{backup}: {part}"), ": no backup of ours")
        settings = loading.load(folder / CONFIG)
        every = places(config, settings)
        found = {part: path for part, path in every.items() if (folder / part).exists()}
        known = places(config, loading.load(config)) if config.exists() else {CONFIG: config}
        for part, path in found.items():
            _refuse_elsewhere(part, path, known.get(part), config)
        if listens(Path(settings.control_socket.path)):
            raise RequestError("the daemon runs; `systemctl stop greenhouse` first")
        taken = [str(path) for path in found.values() if path.exists()]
        if taken and not replaces:
            raise RequestError(f"already there: {', '.join(taken)}; --replace keeps them under another name")
        if not agrees([f"{path}  {_bytes_of(folder / part)} bytes" for part, path in found.items()]):
            raise RequestError("nothing was restored")
        for part, path in found.items():
            kept = _put(folder / part, path, stamp)
            is_roots_key = part == "signing.key" and not path.lstat().st_uid
            owner = "; chown it to the daemon's user" if is_roots_key else ""
            yield f"{path}{f' (before: {kept})' if kept else ''}{owner}"


def _refuse_elsewhere(part: str, path: Path, known: Path | None, config: Path) -> None:
    """Refuse a place that neither the package nor a configuration on this machine names. Errors: DataError

    What is in a backup may come from a stranger, and root writes it.
    """
    is_config = part.removesuffix(BEFORE) in _IN_ETC
    home = ETC if is_config else PAGE_FOLDER if part == PAGE else VAR
    place = Path(os.path.normpath(path.absolute()))
    next_to_config = is_config and path.parent == config.parent and part in places(config, Settings())
    if path == known or home in place.parents or (next_to_config and path.name == part):
        return
    raise DataError(
        f"the backup's edge.yaml puts {part} at {path}, outside {home}. To restore it there, write a "
        f"{config} that names this place, and restore with --replace"
    )


class _Bounded(gzip.GzipFile):
    """A packed file that gives `left` bytes at most. A tar's headers can be as large as its members."""

    left = _CHUNK

    def read(self, size: int | None = -1) -> bytes:
        """Return bytes. Errors: OSError for too many"""
        self.left -= size or 0
        if size is None or size < 0 or self.left < 0:
            raise OSError(errno.EFBIG, "holds more than a backup of its size can")
        return super().read(size)


def _unpack(backup: Path, folder: Path) -> None:
    """Unpack what the manifest names, and check each file. Errors: DataError"""
    no_backup = f"{backup} is no backup of `greenhouse backup`"
    damaged, other = f"{backup} is damaged or cut off; nothing was changed", no_backup
    try:
        with (
            open_file(backup) as file,
            _Bounded(fileobj=file) as stream,
            tarfile.open(fileobj=stream, mode="r:") as archive,
        ):
            stream.left = max(TABLE, UNPACKED_TIMES * os.fstat(file.fileno()).st_size)
            first = archive.next()
            content = archive.extractfile(first) if first is not None and first.name == MANIFEST else None
            if content is None:
                raise DataError(f"{no_backup}: its first member is not {MANIFEST}")
            other, manifest = damaged, read_manifest(content.read(_CHUNK), f"{backup}: {MANIFEST}")
            while (member := archive.next()) is not None:
                _unpack_file(archive, member, manifest, folder, backup)
    except (tarfile.TarError, gzip.BadGzipFile, zlib.error, EOFError) as error:
        is_cut = isinstance(error, zlib.error | EOFError)
        raise DataError(damaged if is_cut else other) from error
    except OSError as error:
        raise DataError(f"{backup}: {error}") from error
    missing = [name for name in manifest.files if not (folder / name).is_file()]
    if missing or CONFIG not in manifest.files:
        raise DataError(f"{backup}: incomplete: {', '.join(missing) or CONFIG} is missing")
    modes = {name: 0o700 for name in SECRETS} | dict(manifest.folders)  # older backups name no folders
    for name, mode in modes.items():
        if _is_plain(name) and (folder / name).is_dir():
            (folder / name).chmod(mode & 0o777)


def _is_plain(name: str) -> bool:
    return _NAME.fullmatch(name) is not None and not {".", ".."} & set(Path(name).parts)


def _unpack_file(
    archive: tarfile.TarFile, member: tarfile.TarInfo, manifest: BackupManifest, folder: Path, backup: Path
) -> None:
    if member.name not in manifest.files or not member.isfile() or not _is_plain(member.name):
        raise DataError(f"{backup}: {member.name!r} does not belong into a backup")
    if Path(member.name).parts[0].removesuffix(BEFORE) in SMALL_PARTS and member.size > SMALL:
        raise DataError(f"{backup}: {member.name} has {member.size} bytes, more than {SMALL}")
    target = folder / member.name
    target.parent.mkdir(parents=True, exist_ok=True)
    stream = archive.extractfile(member)
    assert stream is not None
    with target.open("xb") as file:
        shutil.copyfileobj(stream, file, _CHUNK)
    target.chmod(member.mode & 0o777)
    if _digest(target) != manifest.files[member.name]:
        raise DataError(f"{backup}: {member.name} is damaged: its SHA-256 is another one")


def _put(source: Path, path: Path, stamp: str) -> Path | None:
    """Move a file or folder into its place; return where the one before is."""
    make_folder(path.parent)
    draft = path.with_name(f".{path.name}.restored")
    with as_owner(path):
        if draft.is_dir() and not draft.is_symlink():
            shutil.rmtree(draft)
        draft.unlink(missing_ok=True)
    _write_copy(source, draft)
    kept = path.with_name(f"{path.name}.before-{stamp}") if path.exists() else None
    if kept is not None:
        move(path, kept)
    # The old one's log would spoil the new one.
    for ending in COMPANIONS if source.name in DATABASES else ():
        beside = path.with_name(path.name + ending)
        if beside.exists():
            move(beside, path.with_name(f"{path.name}.before-{stamp}{ending}"))
    move(draft, path)
    return kept


def _write_copy(source: Path, target: Path) -> None:
    """Copy a file or folder; it belongs to the owner of the folder that it is put in."""
    mode = source.stat().st_mode & 0o777
    if source.is_dir():
        with as_owner(target):
            target.mkdir()
            _give(os.open(target, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW), target.parent, mode)
        for entry in sorted(source.iterdir()):
            _write_copy(entry, target / entry.name)
        return
    with source.open("rb") as file:
        with as_owner(target):
            descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
            _give(os.dup(descriptor), target.parent, mode)
        with os.fdopen(descriptor, "wb") as out:
            shutil.copyfileobj(file, out, _CHUNK)
            out.flush()
            os.fsync(descriptor)


def _give(descriptor: int, folder: Path, mode: int) -> None:
    with suppress(PermissionError):  # whoever is not root owns it already
        os.fchown(descriptor, -1, folder.stat().st_gid)
    os.fchmod(descriptor, mode)
    os.close(descriptor)
