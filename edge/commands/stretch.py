"""Arguments that say which stretch of which history."""

import argparse
import re
import time
from datetime import UTC, datetime
from pathlib import Path

from edge.config.settings import HistorySettings
from edge.core.errors import RequestError
from edge.storage.runs import newest_utc

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
        help="from this time on: 2026-07-01T12:00 (UTC unless it names a zone), or 14d, 36h, 90min "
        "before the newest record",
    )
    parser.add_argument("--until", help="up to this time; default: the newest record")


def bounds(arguments: argparse.Namespace, history: Path) -> tuple[float | None, float | None]:
    """Return --since and --until in seconds since 1970, None for no bound.

    Errors : RequestError, DataError where an age is given and the history cannot be read
    """
    return moment_in(history, arguments.since), moment_in(history, arguments.until)


def moment_in(history: Path, text: str | None) -> float | None:
    """Return a moment of a history: an age counts from its newest tick. Errors: RequestError, DataError"""
    is_age = text is not None and _AGE.fullmatch(text)
    return moment(text, newest_utc(history) if is_age else None)


def moment(text: str | None, now_utc: float | None = None) -> float | None:
    """Seconds since 1970, None for no bound.

    now_utc : an age like `14d` counts from it, but never from later than this machine's clock; a demo's
        simulated time lies in the past
    Errors : RequestError
    """
    if text is None:
        return None
    if age := _AGE.fullmatch(text):
        seconds = float(age[1]) * _UNIT_S[age[2]]
        return (time.time() if now_utc is None else min(now_utc, time.time())) - seconds
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise RequestError(f"{text!r} is no time like 2026-07-01T12:00 and no age like 14d") from None
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
