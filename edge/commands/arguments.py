"""Arguments that several commands share: numbers, files, a stretch of a history."""

import argparse
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from edge.commands.which_rig import RIG_CONFIG
from edge.config.settings import HistorySettings
from edge.core.errors import DataError, RequestError
from edge.formats.run_lines import OPTION_WITHOUT
from edge.storage.runs import newest_utc

_UNIT_S = {"d": 86400.0, "h": 3600.0, "min": 60.0}
_AGE = re.compile(r"(\d{1,6}(?:\.\d{1,6})?)(d|h|min)", re.ASCII)


def add_config(parser: argparse.ArgumentParser) -> None:
    """--config."""
    parser.add_argument(
        "--config", type=Path, default=RIG_CONFIG, help="the rig's configuration file; default: %(default)s"
    )


def add_actions(
    parser: argparse.ArgumentParser, helps: Mapping[str, str], otherwise: str = ""
) -> dict[str, argparse.ArgumentParser]:
    """Add a parser for each action. otherwise : what is done without one, "" for nothing"""
    said = f"default: {otherwise}" if otherwise else None
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=not otherwise, help=said)
    return {
        name: actions.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        for name, text in helps.items()
    }


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


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report a file that cannot be written in one line. Errors: DataError"""
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: can't be written: {error.strerror or error}") from error


def add_absent_columns(parser: argparse.ArgumentParser, *columns: str) -> None:
    """Add the options for `columns`, keys of OPTION_WITHOUT; `arguments.without` lists what may be absent."""
    parser.set_defaults(without=[])
    for column in columns:
        parser.add_argument(
            OPTION_WITHOUT[column],
            action="append_const",
            const=column,
            dest="without",
            help=f"accept run files without the column {column}, which was not recorded",
        )


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
