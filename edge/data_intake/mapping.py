"""The mapping file: what `greenhouse data look` understood of a log, for a person to correct."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from edge.core.errors import DataError
from edge.core.plain_text import shown
from edge.data_intake.cells import FileLayout
from edge.data_intake.times import KINDS, zone_of
from edge.data_intake.units import BY_TARGET, TARGETS, UNITS
from edge.formats.atomic_file import write_atomically
from edge.formats.checked import nearest
from edge.formats.input_file import YAML, read_text
from edge.formats.run_file import ABSENT
from edge.formats.strict_yaml import parse_yaml
from edge.twin.value import number

TOP = """# What `greenhouse data look` understood. Where it says GUESS the log does not: read, correct, then
#   greenhouse data convert FILE --map THIS --out RUNS/
"""


@dataclass(frozen=True, slots=True)
class Source:
    """A column of the log for one of ours. full : the number that stands for 1, for the unit `of full`"""

    column: str
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
    try:
        document = parse_yaml(read_text(path, YAML))
        return _log_map(document)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    except yaml.YAMLError as error:
        raise DataError(f"{path}: not YAML: {error}") from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _log_map(document: Any) -> LogMap:
    sections = _keys("the file", document, ("file", "time", "columns"))
    file = _keys("file", sections["file"], ("delimiter", "decimal", "header_line", "encoding"))
    time = _keys(
        "time", sections["time"], ("column", "format", "zone", "period_s", "repeated", "gap_s"), True
    )
    if ("column" in time) == ("period_s" in time):
        raise DataError("time: needs column and format, or period_s for rows at one period")
    text = str(time.get("format", "seconds"))
    if text not in KINDS and "%" not in text:
        raise DataError(f"time.format: {shown(text)} is none of {', '.join(KINDS)}, nor like %d.%m.%Y %H:%M")
    zone = str(time.get("zone", "UTC"))
    zone_of(zone)
    repeated = str(time.get("repeated", "refuse"))
    if repeated not in ("refuse", "first", "last"):
        raise DataError(f"time.repeated: {shown(repeated)} is none of refuse, first, last")
    columns, absent = _columns(sections["columns"])
    header_line = int(number("file.header_line", file["header_line"]))
    layout = FileLayout(str(file["delimiter"]), str(file["decimal"]), header_line, str(file["encoding"]))
    return LogMap(
        layout,
        str(time.get("column", "")),
        text,
        zone,
        columns,
        number("time.gap_s", time.get("gap_s", 600.0)),
        number("time.period_s", time["period_s"]) if "period_s" in time else None,
        absent,
        repeated,
    )


def _columns(document: Any) -> tuple[dict[str, Source], tuple[str, ...]]:
    columns, absent = {}, []
    for target, own in _keys("columns", document, TARGETS, True).items():
        place = f"columns.{target}"
        if own == ABSENT:
            absent.append(target)
            continue
        source = _keys(place, own, ("from", "unit", "full"), True)
        unit = str(source.get("unit"))
        if "from" not in source or unit not in BY_TARGET[target]:
            known = ", ".join(BY_TARGET[target])
            raise DataError(f"{place}: needs `from`, a column, and `unit`, one of {known}")
        full = number(f"{place}.full", source["full"]) if "full" in source else None
        if UNITS[unit].needs_full and not (full is not None and full > 0.0):
            raise DataError(f"{place}.full: the unit `{unit}` needs the number above 0 that stands for full")
        columns[target] = Source(str(source["from"]), unit, full)
    for target in ("temp_air_c", "heater_duty"):
        if target not in columns:
            raise DataError(f"columns.{target}: missing")
    return columns, tuple(absent)


def _keys(place: str, document: Any, known: tuple[str, ...], optional: bool = False) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise DataError(f"{place}: must be a mapping, not {shown(document)}")
    for key in document:
        if key not in known:
            raise DataError(f"{place}: unknown key {shown(key)}; {nearest(str(key), known)}")
    missing = [key for key in known if key not in document]
    if missing and not optional:
        raise DataError(f"{place}.{missing[0]}: missing")
    return document
