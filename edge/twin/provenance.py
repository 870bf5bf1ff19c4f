"""The provenance of a twin: what its file says of how it was found, and numbers read from that."""

import math
from collections.abc import Mapping
from typing import Any

from edge.twin.twin_file import TwinFile

PRIOR = "prior"  # key: of a start that a fleet has given, what boxes of its kind have in common
USUAL_MISS = "misses_k"  # key in it: of free runs by twins of such boxes, over rows that no fit saw
LOSS_SHARE = "loss_share"  # key in it: loss over days, as a share of what an hour tells of it
LOSS_TAKEN = "loss_times"  # key in it: the same, once it is in the twin


def provenance_numbers(file: TwinFile, *keys: str) -> list[float]:
    """Return a number, or a list of numbers, of the provenance; empty where there is none."""
    found: Any = file.provenance
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    items = found if isinstance(found, list) else [found]
    numbers = [float(item) for item in items if isinstance(item, int | float)]
    return numbers if len(numbers) == len(items) and all(map(math.isfinite, numbers)) else []
