"""Values that break careless readers: text, numbers, JSON and bytes, drawn from a generator."""

import json
from typing import Any

import numpy as np

TEXTS = (
    "", " ", "\x00", "\ud800", "\udfff\ud800", "\u202e", "\x1b[2J\x1b[31m", "\r\nHTTP/1.1 200 OK", "é" * 3000,
    "A" * 200_000, "'; DROP TABLE ticks; --", "${jndi:ldap://x}", "%n%s%s", "../../../etc/passwd", "NaN",
    "ON", "PRESS", "null", "1e999", "٣", "1_0", "0x10", "-0", "1" * 400, "\ufeff24", "\n" * 5000,
)  # fmt: skip
NUMBERS = (
    float("nan"), float("inf"), -float("inf"), -0.0, 1e308, -1e308, 5e-324, 2**63, -(2**63) - 1, 10**400,
    True, False, -1, 0.5, 1.0000001, 24,
)  # fmt: skip
DEPTH = 20_000  # of nesting: beyond what Python's recursion takes


def text(rng: np.random.Generator) -> str:
    """Return a string that is hard to store, print or parse."""
    if rng.random() < 0.3:
        return "".join(chr(code) for code in rng.integers(0, 0x110000, int(rng.integers(1, 60))))
    return TEXTS[int(rng.integers(len(TEXTS)))]


def value(rng: np.random.Generator, depth: int = 0) -> Any:
    """Return a JSON value of any type, of the wrong type, or out of every range."""
    kind = int(rng.integers(6 if depth < 3 else 4))
    if kind == 0:
        return text(rng)
    if kind == 1:
        return NUMBERS[int(rng.integers(len(NUMBERS)))]
    if kind == 2:
        return None
    if kind == 3:
        return int(rng.integers(-(2**62), 2**62))
    members = [value(rng, depth + 1) for _ in range(int(rng.integers(0, 4)))]
    return members if kind == 4 else {text(rng)[:100]: member for member in members}


def document(rng: np.random.Generator, honest: dict[str, Any]) -> bytes:
    """`honest` as JSON with something wrong: a value, a key, its nesting, its bytes."""
    changed = dict(honest)
    kind = int(rng.integers(8))
    if kind <= 2 and changed:
        changed[str(rng.choice(sorted(changed)))] = value(rng)
    elif kind == 3:
        changed[text(rng)[:2000]] = value(rng)
    elif kind == 4:
        return b"[" * DEPTH + b"]" * DEPTH
    elif kind == 5:
        return raw(rng)
    elif kind == 6 and changed:
        del changed[str(rng.choice(sorted(changed)))]
    encoded = json.dumps(changed, ensure_ascii=bool(rng.random() < 0.7))
    data = encoded.encode(errors="surrogatepass")
    return data + data if kind == 7 else data


def raw(rng: np.random.Generator) -> bytes:
    """Bytes that are not even text, or text as it comes."""
    if rng.random() < 0.5:
        return rng.bytes(int(rng.integers(0, 4000)))
    return text(rng).encode(errors="surrogatepass")
