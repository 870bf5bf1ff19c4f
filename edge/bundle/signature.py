"""Ed25519 signatures (RFC 8032) over the exact bytes of a manifest, the trusted keys, and a check in a
process of its own: the library that checks them takes 7 MB, which the daemon does without.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from edge.core.errors import DataError
from edge.formats.input_file import Source, read_file

if TYPE_CHECKING:  # the package is imported when a signature is checked, not with the daemon
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
import subprocess
import sys

from edge.core.plain_text import plain
from edge.core.processes import environment

# The public half of the key that signed the bundle which ships with the software.
PACKAGED_KEY = Path(__file__).parent.parent / "models" / "default_bundle.pub"
SIGNATURE_BYTES = 64


def trusted_keys(folder: Path) -> dict[str, "Ed25519PublicKey"]:
    """Public keys by file: each `*.pub` (PEM) of `folder`, where there is one, and the packaged key.

    Errors : DataError for a file that is no Ed25519 public key: a key that is silently left out would be
        looked for in vain
    """
    try:
        files = sorted(folder.glob("*.pub"))
    except OSError as error:
        raise DataError(f"{folder}: {error.strerror}") from error
    packaged = [PACKAGED_KEY] if PACKAGED_KEY.exists() else []
    return {str(path): read_public_key(path) for path in (*files, *packaged)}


def check_signature(content: bytes, signature: bytes, keys: dict[str, "Ed25519PublicKey"]) -> str:
    """File of the key that made `signature` over `content`. Errors: DataError when none of `keys` did."""
    from cryptography.exceptions import InvalidSignature

    if len(signature) != SIGNATURE_BYTES:
        raise DataError(f"the signature has {len(signature)} bytes, not {SIGNATURE_BYTES}")
    for name, key in keys.items():
        try:
            key.verify(signature, content)
        except InvalidSignature:
            continue
        return name
    raise DataError(f"the signature is by none of the {len(keys)} trusted keys ({', '.join(keys) or 'none'})")


def read_public_key(path: Source) -> "Ed25519PublicKey":
    """Return the key in a PEM file. Errors: DataError, which names the file"""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(read_file(path))
    except OSError as error:
        raise DataError(f"{path}: can't be read: {error.strerror}") from error
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise DataError(f"{path}: is no Ed25519 public key (PEM)")
    return key


def fingerprint(key: "Ed25519PublicKey") -> str:
    """Return the SHA-256 of a public key in DER; `openssl pkey -pubin -outform DER | sha256sum` agrees."""
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return hashlib.sha256(key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).hexdigest()


REFUSED = 3  # exit code: the reason is on stdout
TIME_MAX_S = 60.0  # a single-board computer needs 2


def check_apart(content: bytes, signature: bytes, keys: Path) -> None:
    """Check as `check_signature` does, with the trusted keys of the folder `keys`.

    Where the library is loaded already, or no process can be started, it is checked in this process.

    Errors : DataError
    """
    if "cryptography" in sys.modules or len(signature) != SIGNATURE_BYTES:
        check_signature(content, signature, trusted_keys(keys))
        return
    command = [sys.executable, "-m", "edge.bundle.signature", str(keys.absolute())]
    try:
        done = subprocess.run(
            command, input=signature + content, capture_output=True, env=environment(), timeout=TIME_MAX_S
        )
    except OSError:
        check_signature(content, signature, trusted_keys(keys))
        return
    except subprocess.TimeoutExpired:
        raise DataError(f"the signature is not checked after {TIME_MAX_S:g} s") from None
    if done.returncode == REFUSED:
        raise DataError(plain(done.stdout.decode(errors="replace"), 400))
    if done.returncode:
        said = plain(done.stderr.decode(errors="replace")[-200:])
        raise DataError(f"the process that checks the signature ended with {done.returncode}: {said}")


def main(keys: str) -> int:
    """Check what stands on standard input: the signature, then what it signs."""
    signed = sys.stdin.buffer.read()
    try:
        check_signature(signed[SIGNATURE_BYTES:], signed[:SIGNATURE_BYTES], trusted_keys(Path(keys)))
    except DataError as error:
        print(error)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
