"""Text from outside made fit for JSON, a database, a log and a terminal; the one place where it is cleaned.

A lone surrogate cannot be encoded, so one of them would make a tick unstorable; a control character moves the
cursor of whoever reads the log.
"""

import re
from typing import Any

REPLACEMENT = "\ufffd"
# Control characters but tab and line ends, which a text of several lines may have; and lone surrogates.
_UNSTORABLE = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


def storable(text: str) -> str:
    """Return the text with U+FFFD for each lone surrogate and a space for each control character."""
    return text if text.isprintable() else _UNSTORABLE.sub(_replacement, text)


def plain(text: str, longest: int = 200) -> str:
    """One line of at most `longest` printable characters; a longer text ends in "..."."""
    known = text[: 4 * longest]  # a megabyte is not cleaned to keep a line of it
    if not known.isprintable():
        known = "".join(letter if letter.isprintable() else " " for letter in known)
    line = " ".join(known.split())
    is_whole = len(known) == len(text) and len(line) <= longest
    return line if is_whole else f"{line[: longest - 3]}..."


def fan_in_words(share: float) -> str:
    """Return `off`, `on`, or for how much of the step the fan is on."""
    return "off" if share <= 0.0 else "on" if share >= 1.0 else f"{100 * share:.0f} %"


def quote(value: Any, longest: int = 60) -> str:
    """Return a value as errors quote it."""
    return plain(repr(value), longest)


def _replacement(found: re.Match[str]) -> str:
    return REPLACEMENT if found[0] >= "\ud800" else " "
