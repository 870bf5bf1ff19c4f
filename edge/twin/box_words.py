"""Sizes of a greenhouse as a person types them: `27 l`, `0.15m3`, `50x50x60 cm`, `plywood:12mm`."""

import re
from collections.abc import Mapping

from edge.core.errors import RequestError
from edge.core.plain_text import quote
from edge.twin.new_file import CONDUCTIVITY_W_M_K

NUMBER = r"(\d+\.?\d*|\.\d+)"
VOLUME, LENGTH = {"l": 1e-3, "m3": 1.0, "litres": 1e-3}, {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def quantity(word: str, units: Mapping[str, float], bare: str = "") -> float:
    """Return a number times the factor of its unit.

    units : factor by unit
    bare : unit of a number without one; "" where the unit must stand
    Errors : RequestError
    """
    factors = {_plain(unit): factor for unit, factor in units.items()}
    match = re.fullmatch(rf"{NUMBER}({'|'.join(map(re.escape, factors))})?", _plain(word))
    if match is None:
        raise RequestError(f"{quote(word)} is not a number with its unit, {' or '.join(units)}")
    if match[2] is None and not bare:
        raise RequestError(f"{quote(word)} needs its unit, {' or '.join(units)}")
    return float(match[1]) * factors[match[2] or _plain(bare)]


def volume(word: str) -> float:
    """Return a volume [m3] from a volume or three edges. Errors: RequestError"""
    return edges(word) if "x" in _plain(word) else quantity(word, VOLUME)


def edges(word: str) -> float:
    """Return the volume between three edges [m3]. Errors: RequestError"""
    match = re.fullmatch(rf"{NUMBER}x{NUMBER}x{NUMBER}({'|'.join(LENGTH)})", _plain(word))
    if match is None:
        raise RequestError(f"{quote(word)} is not like 50x50x60cm")
    return float(match[1]) * float(match[2]) * float(match[3]) * LENGTH[match[4]] ** 3


def wall(word: str) -> tuple[str, float]:
    """Return material and thickness [m] of `plywood:12mm`. Errors: RequestError"""
    material, _, thickness = word.partition(":")
    if material.strip() not in CONDUCTIVITY_W_M_K:
        raise RequestError(f"{quote(material)} is none of {', '.join(CONDUCTIVITY_W_M_K)}")
    return material.strip(), quantity(thickness, LENGTH)


def _plain(word: str) -> str:
    return re.sub(r"\s+", "", word).lower().replace("³", "3").replace("²", "2").replace("°", "")
