"""Is this folder a bundle that may be used? Signature first: nothing unsigned is even parsed."""

import hashlib
import stat
from pathlib import Path

from edge.bundle.archive import FILE_BYTES_MAX
from edge.bundle.manifest import MANIFEST, SIGNATURE, Manifest, parse_manifest
from edge.bundle.signature import check_signature, trusted_keys
from edge.errors import DataError

_MANIFEST_BYTES_MAX = 1 << 20


def check_folder(folder: Path, keys: Path) -> Manifest:
    """The manifest of the bundle in `folder`: signed by a trusted key, every file whole, no file too many.

    keys : folder of trusted public keys
    Errors : DataError with what is wrong, beginning with the file's name
    """
    try:
        content = _read(folder / MANIFEST, _MANIFEST_BYTES_MAX)
        signature = _read(folder / SIGNATURE, _MANIFEST_BYTES_MAX)
        check_signature(content, signature, trusted_keys(keys))
        manifest = parse_manifest(content)
        _check_files(folder, manifest)
    except OSError as error:
        raise DataError(f"{error.filename or folder}: {error.strerror}") from error
    return manifest


def _check_files(folder: Path, manifest: Manifest) -> None:
    there = {path.name for path in folder.iterdir()}
    for name in sorted(there - set(manifest.files) - {MANIFEST, SIGNATURE}):
        raise DataError(f"{name}: is not in the manifest")
    for name, entry in manifest.files.items():
        if name not in there:
            raise DataError(f"{name}: is missing")
        size = (folder / name).lstat().st_size
        if size != entry.size:
            raise DataError(f"{name}: has {size} bytes, the manifest says {entry.size}")
        if hashlib.sha256(_read(folder / name, FILE_BYTES_MAX)).hexdigest() != entry.sha256:
            raise DataError(f"{name}: its sha256 is not the manifest's")


def _read(path: Path, bytes_max: int) -> bytes:
    """A plain file's bytes."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        raise DataError(f"{path.name}: is missing") from None
    if not stat.S_ISREG(status.st_mode):
        raise DataError(f"{path.name}: is no plain file")
    if status.st_size > bytes_max:
        raise DataError(f"{path.name}: {status.st_size} bytes are too many, {bytes_max} are allowed")
    return path.read_bytes()
