"""The mapping file: what `greenhouse data look` understood of a log, for a person to correct."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import yaml

from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.data_intake.cells import FileLayout
from edge.data_intake.times import KINDS, zone_of
from edge.data_intake.units import BY_TARGET, TARGETS, UNITS
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.reader import read, read_yaml
from edge.formats.run_lines import ABSENT

TOP = """# What `greenhouse data look` understood. Where it says GUESS the log does not: read, correct, then
#   greenhouse data convert FILE --map THIS --out RUNS/
"""


@dataclass(frozen=True, slots=True)
class Source:
    """A column of the log for one of ours. full : the number that stands for 1, for the unit `of full`"""

    column: str = field(metadata={"key": "from"})
    unit: str
    full: float | None = None


@dataclass(frozen=True, slots=True)
class LogMap:
    """time : column, or "" for rows at `period_s`; guesses : by place (`columns.fan_on`), why"""

    layout: FileLayout
    time: str
    time_format: str
    zone: str
    columns: Mapping[str, Source]
    gap_s: float
    period_s: float | None = None
    absent: tuple[str, ...] = ()
    repeated: str = "refuse"
    guesses: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeDocument(CheckedDocument):
    """How the file says when a row was taken."""

    column: str | None = None
    format: str = "seconds"
    zone: str = "UTC"
    period_s: float | None = None
    repeated: Annotated[str, Rule(choices=("refuse", "first", "last"))] = "refuse"
    gap_s: float = 600.0

    def cross_check(self) -> None:
        """Check that the time is a column with a known format, or a period."""
        if (self.column is None) == (self.period_s is None):
            self.refuse("", "needs column and format, or period_s for rows at one period")
        if self.format not in KINDS and "%" not in self.format:
            kinds = ", ".join(KINDS)
            self.refuse("format", f"{quote(self.format)} is none of {kinds}, nor like %d.%m.%Y %H:%M")


@dataclass(frozen=True, slots=True)
class MapDocument:
    """The file, section by section; a column is a `Source` or ABSENT."""

    file: FileLayout
    time: TimeDocument
    columns: Mapping[Annotated[str, Rule(choices=TARGETS)], Any]


def write_map(found: LogMap, path: Path) -> None:
    """As YAML with each guess behind its line. Errors: OSError"""
    time: dict[str, Any] = {"column": found.time, "format": found.time_format, "zone": found.zone}
    if not found.time:
        time = {"period_s": found.period_s}
    document: dict[str, Any] = {
        "file": {
            "delimiter": found.layout.delimiter,
            "decimal": found.layout.decimal,
            "header_line": found.layout.header_line,
            "encoding": found.layout.encoding,
        },
        "time": {**time, "repeated": found.repeated, "gap_s": found.gap_s},
        "columns": {
            **{target: _document(source) for target, source in found.columns.items()},
            **dict.fromkeys(found.absent, ABSENT),
        },
    }
    # Written line by line: a YAML writer has no place for the comment that a guess needs.
    lines = []
    for section, values in document.items():
        lines.append(f"{section}:")
        for key, value in values.items():
            text = yaml.safe_dump(value, default_flow_style=True, width=1000, allow_unicode=True)
            text = text.removesuffix("\n").removesuffix("\n...")
            guess = found.guesses.get(f"{section}.{key}")
            lines.append(f"  {key}: {text}" + (f"  # GUESS: {guess}" if guess else ""))
    write_atomically(path, TOP + "\n".join(lines) + "\n")


def _document(source: Source) -> dict[str, Any]:
    full = {} if source.full is None else {"full": source.full}
    return {"from": source.column, "unit": source.unit, **full}


def read_map(path: Path) -> LogMap:
    """Errors: DataError naming the key."""
    document = read_yaml(MapDocument, path)
    try:
        return _log_map(document)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _log_map(document: MapDocument) -> LogMap:
    time = document.time
    zone_of(time.zone)
    columns, absent = _columns(document.columns)
    return LogMap(
        document.file,
        time.column or "",
        time.format,
        time.zone,
        columns,
        time.gap_s,
        time.period_s,
        absent,
        time.repeated,
    )


def _columns(document: Mapping[str, Any]) -> tuple[dict[str, Source], tuple[str, ...]]:
    columns, absent = {}, []
    for target, own in document.items():
        place = f"columns.{target}"
        if own == ABSENT:
            absent.append(target)
            continue
        source = read(Source, own, key=place)
        if source.unit not in BY_TARGET[target]:
            known = ", ".join(BY_TARGET[target])
            raise DataError(f"{place}.unit: {quote(source.unit)} is none of {known}")
        if UNITS[source.unit].needs_full and not (source.full is not None and source.full > 0.0):
            raise DataError(
                f"{place}.full: the unit `{source.unit}` needs the number above 0 that stands for full"
            )
        columns[target] = source
    for target in ("temp_air_c", "heater_duty"):
        if target not in columns:
            raise DataError(f"columns.{target}: missing")
    return columns, tuple(absent)
