"""A bundle on its way: one zip file. It is read as if an enemy had made it.

Zip and not tar: it has no links or devices to guard against, since only names and bytes are taken from it.
"""

import io
import os
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO

from edge.bundle.manifest import FILE_NAME
from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.input_file import MODEL, open_file

FILES_MAX = 64
FILE_BYTES_MAX = MODEL
TOTAL_BYTES_MAX = 32 << 20
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same files make the same archive


@dataclass(frozen=True, slots=True)
class ArchiveLimits:
    """The most that an archive may hold. kind : its name in messages; file_bytes, total_bytes : unpacked"""

    kind: str
    files: int
    file_bytes: int
    total_bytes: int


BUNDLE = ArchiveLimits("bundle", FILES_MAX, FILE_BYTES_MAX, TOTAL_BYTES_MAX)


def pack(folder: Path, limits: ArchiveLimits = BUNDLE) -> bytes:
    """All files of `folder` as an archive, the same bytes for the same files. Errors: DataError, OSError"""
    out = io.BytesIO()
    paths = sorted(folder.iterdir())
    _check_sizes([(path.name, _regular_size(path)) for path in paths], limits)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in paths:
            info = zipfile.ZipInfo(path.name, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW), "rb") as file:
                archive.writestr(info, file.read(limits.file_bytes))
    return out.getvalue()


def open_archive(source: Path) -> BinaryIO:
    """Open the archive `source`, or pack the folder `source` as one. Errors: DataError"""
    try:
        if not source.is_dir():
            return open_file(source)
        return io.BytesIO(pack(source))  # bounded by what `pack` takes
    except OSError as error:
        raise DataError(f"{source}: {error.strerror or error}") from error
    except DataError as error:
        raise DataError(f"{source}: {error}") from error


def unpack(source: BinaryIO, into: Path, limits: ArchiveLimits = BUNDLE) -> None:
    """Files of an archive into the empty folder `into`, written through.

    Errors : DataError for what is no archive, is damaged, or tries to be more than files in one folder
    """
    if source.seek(0, os.SEEK_END) > limits.total_bytes:
        raise DataError(f"more bytes than a {limits.kind} may have, {limits.total_bytes}")
    try:
        with zipfile.ZipFile(source) as archive:
            entries = archive.infolist()
            _check_sizes([(entry.filename, entry.file_size) for entry in entries], limits)
            for entry in entries:
                with archive.open(entry) as file:
                    write_atomically(
                        into / entry.filename, _read_bounded(file, entry.filename, entry.file_size)
                    )
    # RuntimeError: encrypted; NotImplementedError: a compression that zipfile does not know
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, ValueError) as error:
        raise DataError(f"no {limits.kind} archive, or damaged: {error}") from error


def _regular_size(path: Path) -> int:
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise DataError(f"{path.name}: is no plain file")
    return status.st_size


def _check_sizes(entries: list[tuple[str, int]], limits: ArchiveLimits) -> None:
    if len(entries) > limits.files:
        raise DataError(f"{len(entries)} files are more than a {limits.kind} may hold, {limits.files}")
    if len({name for name, _ in entries}) < len(entries):
        raise DataError("a file name stands there twice")
    for name, size in entries:
        if not FILE_NAME.fullmatch(name):
            raise DataError(f"{name!r} is no name for a file of a {limits.kind}")
        if size > limits.file_bytes:
            raise DataError(f"{name}: {size} bytes are more than a file may have, {limits.file_bytes}")
    total = sum(size for _, size in entries)
    if total > limits.total_bytes:
        raise DataError(f"{total} bytes are more than a {limits.kind} may have, {limits.total_bytes}")


def _read_bounded(file: IO[bytes], name: str, size: int) -> bytes:
    """Return all that the file holds. Errors: DataError where that is more than `size` bytes"""
    content = file.read(size + 1)
    if len(content) > size:
        raise DataError(f"{name}: holds more than its {size} bytes")
    return content
