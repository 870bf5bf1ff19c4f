"""The twin that a rig tells: read as a twin's file is, so that nothing unreadable gets into the database."""

import re
from dataclasses import dataclass
from typing import Any

from edge.bundle.manifest import FILE_NAME
from edge.core.errors import DataError
from edge.core.plain_text import plain, quote
from edge.twin.twin_file import twin_of
from fleet.ingest.refusal import Refused
from fleet.ingest.tick import parse_body


@dataclass(frozen=True, slots=True)
class HeardTwin:
    """The payload of the topic `twin`. document : of a twin file"""

    bundle: str
    document: dict[str, Any]


def parse_twin(payload: bytes) -> HeardTwin | None:
    """Return the twin, None for a rig that takes it back. Errors: Refused"""
    if not payload:
        return None
    body = parse_body(payload)
    bundle, document = body.get("bundle"), body.get("twin")
    if not isinstance(bundle, str) or not re.fullmatch(FILE_NAME, bundle) or not isinstance(document, dict):
        raise Refused("value", f"twin: {quote(bundle)} is no bundle's name, or there is no twin")
    try:
        twin_of(document)
    except DataError as error:
        raise Refused("value", f"twin: {plain(str(error))}") from None
    return HeardTwin(bundle, document)
