"""Numbers on the command line: argparse names the option and prints what these functions say."""

import argparse
import math
from collections.abc import Callable

SEED_MAX = 2**32 - 1  # that every random generator takes


def number(low: float, high: float = math.inf, above: bool = False) -> Callable[[str], float]:
    """Return the type of an option from `low` to `high`, finite; `above` excludes `low` itself."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or not low <= value <= high or (above and value == low):
            raise argparse.ArgumentTypeError(f"{text!r} is not {_range('a number', low, high, above)}")
        return value

    return parse


def whole(low: int, high: float = math.inf) -> Callable[[str], int]:
    """Return the type of an option that is a whole number from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {_range('a whole number', low, high, False)}")
        return value

    return parse


def _range(what: str, low: float, high: float, above: bool) -> str:
    if high == math.inf:
        return f"{what} above {low:g}" if above else f"{what} of {low:g} or more"
    return f"{what} above {low:g}, up to {high:g}" if above else f"{what} from {low:g} to {high:g}"
