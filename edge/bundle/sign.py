"""The signing side of bundles: keys, and a folder of models made into one signed archive.

The private key stays with the person who trains; rigs know the public one. A rig that is to sign what it
finds itself has a key of its own (`bundle.signing_key`), and trusts it only when a person with root has put
its public half among the trusted ones. Keys are PEM files that openssl reads too.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from edge.bundle.archive import pack
from edge.bundle.manifest import (
    MANIFEST,
    MODELS,
    POLICY,
    SIGNATURE,
    TWIN,
    UNITS,
    FileEntry,
    Manifest,
    ModelEntry,
    parse_manifest,
    write_manifest,
)
from edge.core.controller_names import RL
from edge.core.errors import DataError
from edge.core.version import __version__
from edge.formats.atomic_file import write_atomically
from edge.formats.input_file import read_file
from edge.models.pbm import read_twin

if TYPE_CHECKING:  # the package is imported when something is signed, not with the daemon
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

# Model -> its file, the first that is there: a PBM that is another twin than the hybrid's has its own.
FILES = {"arx": ("arx.json",), "pbm": ("pbm.yaml", TWIN), "lstm": ("lstm.onnx",), "ham": ("ham.onnx",)}
POLICY_FILES = {name: f"{name.lower()}.onnx" for name in RL}  # RL-Off -> rl-off.onnx
PUBLIC_SUFFIX = ".pub"


@dataclass(frozen=True, slots=True)
class ManifestFacts:
    """Facts of a manifest that cannot be read off the files."""

    version: str
    created_utc: str  # 2026-07-01T12:00:00Z
    data_sha256: str  # of the recorded runs
    sample_s: float = 60.0
    name: str = "greenhouse-models"
    software: Mapping[str, str] = field(default_factory=dict)  # package -> version
    minimum_software: str = __version__


def generate_key(path: Path) -> Path:
    """Write a new private key to `path`, readable by its owner alone.
    Returns the public key's file, in the same folder.

    Errors : DataError when either file is there already: a lost key can't be made again
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
        PublicFormat,
    )

    public = path.with_suffix(PUBLIC_SUFFIX)
    if public == path:
        raise DataError(f"{path}: {PUBLIC_SUFFIX} is the public key's ending")
    if public.exists():
        raise DataError(f"{public}: is there already and is not overwritten")
    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    _write_new(path, private, 0o600)
    _write_new(public, key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo), 0o644)
    return public


def sign_folder(folder: Path, facts: ManifestFacts, key: Path) -> Manifest:
    """Write manifest.json and manifest.sig for all files of `folder`, over older ones.

    Errors : DataError for a missing twin, a wrong fact or a file that is no private key
    """
    # The key first: a wrong one should cost nothing that was written.
    signer = read_private_key(key)
    names = sorted(path.name for path in folder.iterdir() if path.name not in (MANIFEST, SIGNATURE))
    manifest = Manifest(
        name=facts.name,
        version=facts.version,
        created_utc=facts.created_utc,
        sample_s=facts.sample_s,
        files={name: _entry(folder / name) for name in names},
        models=_models(names),
        twin_sha256=read_twin(folder / TWIN).twin.sha256,
        data_sha256=facts.data_sha256,
        software=facts.software,
        minimum_software=facts.minimum_software,
        units=UNITS,
        policies={name: ModelEntry(file, POLICY) for name, file in POLICY_FILES.items() if file in names},
    )
    content = write_manifest(manifest)
    parse_manifest(content)  # what the edge would refuse is not signed
    (folder / MANIFEST).write_bytes(content)
    (folder / SIGNATURE).write_bytes(signer.sign(content))
    return manifest


def build_bundle(folder: Path, out: Path, facts: ManifestFacts, key: Path) -> Manifest:
    """Pack the files of `folder` as a signed archive `out`; the folder stays. Errors: DataError, OSError"""
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        copy = Path(temporary)
        for path in folder.iterdir():
            shutil.copyfile(path, copy / path.name)
        manifest = sign_folder(copy, facts, key)
        write_atomically(out, pack(copy))
    return manifest


def _models(names: Sequence[str]) -> dict[str, ModelEntry]:
    found = {model: next((file for file in files if file in names), None) for model, files in FILES.items()}
    return {model: ModelEntry(file, MODELS[model]) for model, file in found.items() if file is not None}


def _entry(path: Path) -> FileEntry:
    content = path.read_bytes()
    return FileEntry(hashlib.sha256(content).hexdigest(), len(content))


def _write_new(path: Path, content: bytes, mode: int) -> None:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except FileExistsError:
        raise DataError(f"{path}: is there already and is not overwritten") from None
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)


def read_private_key(path: Path) -> "Ed25519PrivateKey":
    """Return the key in a PEM file. Errors: DataError, which names the file"""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(read_file(path), password=None)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    except (ValueError, TypeError):  # no PEM; encrypted
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise DataError(f"{path}: is no Ed25519 private key (PEM, not encrypted)")
    return key
