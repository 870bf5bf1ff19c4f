"""Hashes of secrets and passwords, and the names of people.

A link's or a session's secret is shown once and kept as its SHA-256: it has 256 random bits, so nothing can
be guessed from that. Passwords are short, so they are kept by scrypt.
"""

import hashlib
import hmac
import secrets

from edge.core.errors import RequestError
from edge.core.plain_text import plain

SCRYPT = {"n": 1 << 14, "r": 8, "p": 1}  # 16 MB and a quarter of a second of a Raspberry Pi
PASSWORD_MIN = 8  # characters
NAME_MAX = 40
NOBODY = (b"nobody", b"")  # salt and hash of no password: as slow to refuse as a wrong one


def hash_secret(secret: str) -> bytes:
    """Return the hash of a link's or a session's secret."""
    return hashlib.sha256(secret.encode(errors="replace")).digest()


def new_password(password: str) -> tuple[bytes, bytes]:
    """Return salt and hash. Errors: RequestError for one that is too short"""
    if len(password) < PASSWORD_MIN:
        raise RequestError(f"a password has {PASSWORD_MIN} characters at least")
    salt = secrets.token_bytes(16)
    return salt, _scrypt(password, salt)


def is_password(password: str, salt: bytes, known: bytes) -> bool:
    """Return whether it is the one with this salt and hash."""
    return hmac.compare_digest(_scrypt(password, salt), known)


def person_name(name: str) -> str:
    """Return a name as it may stand in the history. Errors: RequestError"""
    clean = plain(name, NAME_MAX).strip()
    if not clean:
        raise RequestError("a name is needed: it stands beside every order in the history")
    return clean


def _scrypt(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(errors="replace"), salt=salt, **SCRYPT, maxmem=64 << 20)
