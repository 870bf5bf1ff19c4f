"""An API key, and texts it can be read from, found in what a server says and masked: a server may echo it."""

import base64
import re

MASK = "***"
SECRET_MIN = 8  # a shorter key is a placeholder such as "none": masking it would spoil answers [characters]
PADDINGS = range(3)  # base64 packs three bytes: the key looks different at each place in a longer text
_URLSAFE = str.maketrans("+/", "-_")


def key_pattern(key: str) -> re.Pattern[str] | None:
    """The pattern of everything that gives `key` away, None for a key that is not a secret.

    Found are the key itself, its hex digits and its base64 (the usual and the URL-safe alphabet, alone and
    inside a longer text such as "Bearer ..."), each also escaped as JSON or URLs escape, however often.
    """
    if len(key) < SECRET_MIN:
        return None
    raw = key.encode()
    encoded = [base64_inside(raw, padding) for padding in PADDINGS]
    forms = [key, *encoded, *(form.translate(_URLSAFE) for form in encoded)]
    patterns = ["".join(_letter(letter) for letter in form) for form in dict.fromkeys(forms)]
    separator = f"(?:{_letter(' ')}|{_letter(':')})?"
    digits = separator.join("".join(map(_hex_digit, pair)) for pair in raw.hex(" ").split())
    return re.compile("|".join([*patterns, digits]))


def base64_inside(raw: bytes, padding: int) -> str:
    """The characters that `raw` alone decides where `padding` bytes (modulo 3) stand before it."""
    encoded = base64.b64encode(b"\0" * padding + raw).decode().rstrip("=")
    return encoded[-(-padding * 8 // 6) : (padding + len(raw)) * 8 // 6]


def _letter(letter: str) -> str:
    """The letter, or how JSON (at any depth of quoting) and URLs escape it."""
    code = ord(letter)
    url = "".join(f"%(?:25){{0,4}}{byte:02x}" for byte in letter.encode())
    return rf"(?:\\{{0,8}}{re.escape(letter)}|(?i:\\{{1,8}}u{code:04x}|{url}))"


def _hex_digit(digit: str) -> str:
    return f"(?:{_letter(digit)}|{_letter(digit.upper())})"
