"""Time columns: ISO, numbers since 1970 or the start, spreadsheet days, and dates as people write them."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.data_intake.cells import Cells, is_missing, number

Floats = NDArray[np.float64]
SINCE_1970 = {"epoch_s": 1.0, "epoch_ms": 1e3, "epoch_us": 1e6, "epoch_ns": 1e9}  # per second
SINCE_START = {"seconds": 1.0, "minutes": 60.0, "hours": 3600.0}  # in seconds
EXCEL = "spreadsheet_days"  # since 1899-12-30
EXCEL_DAY_1970 = 25569.0
DAY_S = 86400.0
CLOCK = ("%H:%M:%S", "%H:%M")  # the time of day alone: the next day begins where it falls
FORMATS = (
    "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M", "%d/%m/%Y %H:%M:%S", "%d/%m/%Y %H:%M", "%m/%d/%Y %H:%M:%S",
    "%m/%d/%Y %H:%M", "%m/%d/%Y %I:%M:%S %p", "%m/%d/%Y %I:%M %p", "%d-%m-%Y %H:%M:%S", "%d-%m-%Y %H:%M",
    "%Y/%m/%d %H:%M:%S", "%Y/%m/%d %H:%M", "%d %b %Y %H:%M:%S", "%d-%b-%Y %H:%M:%S", "%b %d %Y %H:%M:%S",
    *CLOCK,
)  # fmt: skip
EARLIEST, LATEST = 631152000.0, 4102444800.0  # 1990 and 2100: what else a number may be, it is no date
KINDS = ("iso", *SINCE_1970, *SINCE_START, EXCEL)


def formats_of(cells: Sequence[str], decimal: str) -> list[str]:
    """Every format that all cells can be read in, the likeliest first: of KINDS, or as for `strptime`."""
    known = [cell for cell in cells if not is_missing(cell)]
    numbers = [number(cell, decimal) for cell in known]
    if known and all(value is not None for value in numbers):
        return _number_formats(np.array(numbers, dtype=np.float64))
    found = ["iso"] if all(_is_iso(cell) for cell in known) else []
    return found + [text for text in FORMATS if known and all(_fits(cell, text) for cell in known)]


def _number_formats(values: Floats) -> list[str]:
    inside = [
        name
        for name, per in SINCE_1970.items()
        if (values >= EARLIEST * per).all() and (values < LATEST * per).all()
    ]
    if inside:
        return inside
    if (np.diff(values) < 0.0).any():
        return []
    days = (values - EXCEL_DAY_1970) * DAY_S
    is_days = bool((days >= EARLIEST).all() and (days < LATEST).all() and (values != np.round(values)).any())
    return [EXCEL] if is_days else list(SINCE_START)


def _is_iso(cell: str) -> bool:
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return not cell.replace(":", "").isdigit()


def _fits(cell: str, text: str) -> bool:
    try:
        datetime.strptime(cell, text)
    except ValueError:
        return False
    return True


def zone_of(name: str) -> ZoneInfo:
    """Errors: DataError for a zone that is none."""
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise DataError(f"time.zone: {quote(name)} is no time zone like UTC or Europe/Berlin") from None


def read_times(cells: Cells, column: str, text: str, zone: str) -> tuple[Floats, bool]:
    """Seconds of each row, and whether they count from 1970 rather than from any start.

    text : a format, as of `formats_of`; zone : of dates that say none
    Errors : DataError naming the line
    """
    where = zone_of(zone)
    found = np.empty(len(cells.rows))
    for i, cell in enumerate(cells.column(column)):
        value = _seconds(cell, text, where, cells.layout.decimal)
        if value is None:
            raise DataError(f"{cells.place(i, column)}: {quote(cell)} is no time as {text}")
        found[i] = value
    if text in CLOCK:
        found += DAY_S * np.concatenate([[0.0], np.cumsum(np.diff(found) < 0.0)])
    return found, not (text in SINCE_START or text in CLOCK)


def _seconds(cell: str, text: str, zone: ZoneInfo, decimal: str) -> float | None:
    if text == "iso" or "%" in text:
        try:
            iso = text == "iso"
            moment = datetime.fromisoformat(cell) if iso else datetime.strptime(cell, text)
        except ValueError:
            return None
        if text in CLOCK:
            return timedelta(hours=moment.hour, minutes=moment.minute, seconds=moment.second).total_seconds()
        return (moment if moment.tzinfo else moment.replace(tzinfo=zone)).astimezone(UTC).timestamp()
    value = number(cell, decimal)
    if value is None:
        return None
    if text in SINCE_1970:
        return value / SINCE_1970[text]
    if text == EXCEL:
        moment = datetime.fromtimestamp((value - EXCEL_DAY_1970) * DAY_S, UTC).replace(tzinfo=zone)
        return moment.timestamp()
    return value * SINCE_START[text]
