"""Arguments that say which stretch of which history."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from edge.errors import RequestError
from edge.settings import HistorySettings


def add_bounds(parser: argparse.ArgumentParser) -> None:
    """--history, --since, --until."""
    parser.add_argument("--history", type=Path, default=Path(HistorySettings().path), help="database")
    parser.add_argument("--since", help="from this time on: 2026-07-01T12:00, UTC unless it says a zone")
    parser.add_argument("--until", help="up to this time")


def moment(text: str | None) -> float | None:
    """Seconds since 1970, None for no bound. Errors: RequestError"""
    if text is None:
        return None
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise RequestError(f"{text!r} is no time like 2026-07-01T12:00") from None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
