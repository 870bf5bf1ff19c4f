"""Signatures checked in a process that ends: the daemon does without the 7 MB of the library for it."""

import subprocess
import sys
from pathlib import Path

from edge.bundle.signature import SIGNATURE_BYTES, check_signature, trusted_keys
from edge.core.errors import DataError
from edge.core.own_process import environment
from edge.core.plain_text import plain

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
    command = [sys.executable, "-m", "edge.bundle.signature_process", str(keys.absolute())]
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
