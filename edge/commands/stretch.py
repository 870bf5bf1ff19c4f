"""Arguments that say which stretch of which history."""

import argparse
import re
import time
from datetime import UTC, datetime
from pathlib import Path

from edge.errors import RequestError
from edge.settings import HistorySettings

_UNIT_S = {"d": 86400.0, "h": 3600.0, "min": 60.0}
_AGE = re.compile(r"(\d{1,6}(?:\.\d{1,6})?)(d|h|min)", re.ASCII)


def add_bounds(parser: argparse.ArgumentParser) -> None:
    """--history, --since, --until."""
    parser.add_argument(
        "--history", type=Path, help=f"database; default: {HistorySettings().path}, else the last demo's"
    )
    add_times(parser)


def add_times(parser: argparse.ArgumentParser) -> None:
    """--since, --until."""
    parser.add_argument(
        "--since",
        help="from this time on: 2026-07-01T12:00, UTC unless it says a zone; or ago: 14d, 36h, 90min",
    )
    parser.add_argument("--until", help="up to this time")


def moment(text: str | None, now_utc: float | None = None) -> float | None:
    """Seconds since 1970, None for no bound.

    now_utc : what an age like `14d` counts from; the clock of this machine where it is None
    Errors : RequestError
    """
    if text is None:
        return None
    if age := _AGE.fullmatch(text):
        seconds = float(age[1]) * _UNIT_S[age[2]]
        return (time.time() if now_utc is None else now_utc) - seconds
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise RequestError(f"{text!r} is no time like 2026-07-01T12:00 and no age like 14d") from None
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
