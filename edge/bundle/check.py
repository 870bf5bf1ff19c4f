"""Is this folder a bundle that may be used? Signature first: nothing unsigned is even parsed."""

import hashlib
import stat
from pathlib import Path

from edge.bundle.archive import FILE_BYTES_MAX, TOTAL_BYTES_MAX
from edge.bundle.manifest import MANIFEST, SIGNATURE, Manifest, parse_manifest
from edge.bundle.signature import check_apart
from edge.core.errors import DataError
from edge.formats.input_file import MemoryFolder, read_file

_MANIFEST_BYTES_MAX = 1 << 20


def read_checked(folder: Path, keys: Path) -> tuple[Manifest, MemoryFolder]:
    """Read the bundle in `folder`: signed by a trusted key, every file whole, no file too many.

    Returns : the manifest, and the files' bytes as they were checked, the manifest's among them
    keys : folder of trusted public keys
    Errors : DataError with what is wrong, beginning with the file's name
    """
    try:
        content = _read(folder / MANIFEST, _MANIFEST_BYTES_MAX)
        signature = _read(folder / SIGNATURE, _MANIFEST_BYTES_MAX)
        check_apart(content, signature, keys)
        manifest = parse_manifest(content)
        files = _checked_files(folder, manifest)
    except OSError as error:
        raise DataError(f"{error.filename or folder}: {error.strerror}") from error
    return manifest, MemoryFolder(folder, {MANIFEST: content, **files})


def check_folder(folder: Path, keys: Path) -> Manifest:
    """Check the bundle in `folder` as `read_checked` does and return its manifest. Errors: DataError"""
    return read_checked(folder, keys)[0]


def _checked_files(folder: Path, manifest: Manifest) -> dict[str, bytes]:
    if sum(entry.size for entry in manifest.files.values()) > TOTAL_BYTES_MAX:
        raise DataError(f"{MANIFEST}: files: more than {TOTAL_BYTES_MAX} bytes in all")
    files = {}
    there = {path.name for path in folder.iterdir()}
    for name in sorted(there - set(manifest.files) - {MANIFEST, SIGNATURE}):
        raise DataError(f"{name}: is not in the manifest")
    for name, entry in manifest.files.items():
        if name not in there:
            raise DataError(f"{name}: is missing")
        size = (folder / name).lstat().st_size
        if size != entry.size:
            raise DataError(f"{name}: has {size} bytes, the manifest says {entry.size}")
        files[name] = _read(folder / name, FILE_BYTES_MAX)
        if hashlib.sha256(files[name]).hexdigest() != entry.sha256:
            raise DataError(f"{name}: its sha256 is not the manifest's")
    return files


def _read(path: Path, bytes_max: int) -> bytes:
    """Return a plain file's bytes."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        raise DataError(f"{path.name}: is missing") from None
    if not stat.S_ISREG(status.st_mode):
        raise DataError(f"{path.name}: is no plain file")
    if status.st_size > bytes_max:
        raise DataError(f"{path.name}: {status.st_size} bytes are too many, {bytes_max} are allowed")
    return read_file(path, bytes_max)
