"""Addresses of servers: the one parser of hosts and of http addresses."""

import ipaddress
import re
from contextlib import suppress
from urllib.parse import urlsplit

from edge.core.plain_text import quote


def host_problem(text: str) -> str:
    """Return why a setting is not the name or the address of a host, "" where it is or is empty."""
    return "" if not text or _is_host(text) else f"{quote(text)} is not a host name or an IP address alone"


def url_problem(text: str) -> str:
    """Return why a setting cannot be asked by http, "" where it can or is empty. Quotes no secret."""
    with suppress(ValueError):  # a port that is not a number, a bracket that is not closed
        parts = urlsplit(text)
        is_right = parts.scheme in ("http", "https") and _is_host(parts.hostname or "") and parts.port != 0
        if not text or (is_right and "@" not in parts.netloc and not re.search(r"[\s#]", text)):
            return ""
    return "is not https://HOST/PATH, without user, password, blank and #"


def _is_host(text: str) -> bool:
    with suppress(ValueError):
        return bool(ipaddress.ip_address(text))
    with suppress(UnicodeError):  # a part of the name is empty or too long
        is_name = re.fullmatch(r"[^\s/:?#@%\\\[\]]+", text) and text.encode("idna")
        return bool(is_name) and not text.rpartition(".")[2].isdigit()
    return False
