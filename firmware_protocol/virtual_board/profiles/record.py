"""A profile applied to a chamber: input rows in, run rows out, as design's run files have them."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.virtual_board.chamber import Chamber

FOLDER = Path(__file__).parent
WINDOW_S = 20  # slow PWM of the heater relay, in slots of 1 s (PROTOCOL.md)
SAMPLE_S = 60


@dataclass(frozen=True, slots=True)
class RecordedRow:
    """Inputs that hold from time_s to the next row."""

    time_s: int
    heater_duty: float  # 0..1 in steps of 0.05
    fan_on: int
    light: float = 0.0  # 0..1


def paths() -> list[Path]:
    """Return the predefined input sequences, in order."""
    return sorted(FOLDER.glob("profile_*.csv"))


def read(path: Path) -> tuple[dict[str, str], list[RecordedRow]]:
    """Facts (`# key: value`) and rows of a profile file; the last row marks the end."""
    lines = path.read_text(encoding="utf-8").splitlines()
    facts = dict(line[1:].strip().split(": ", 1) for line in lines if line.startswith("#"))
    table = csv.DictReader(line for line in lines if not line.startswith("#"))
    return facts, [
        RecordedRow(
            int(row["time_s"]), float(row["heater_duty"]), int(row["fan_on"]), float(row["light"] or 0.0)
        )
        for row in table
    ]


def write(path: Path, facts: dict[str, str], rows: Sequence[RecordedRow]) -> None:
    """Write the file that `read` reads."""
    lines = [f"# {key}: {value}" for key, value in facts.items()] + ["time_s,heater_duty,fan_on,light"]
    lines += [f"{row.time_s},{row.heater_duty:g},{row.fan_on},{row.light:g}" for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def record(chamber: Chamber, rows: Sequence[RecordedRow]) -> list[dict[str, float]]:
    """Drive the chamber as the board would, relay by slow PWM; one dict of sensor values and inputs per row.

    A row's inputs are those that hold from its time on; rows lie at multiples of the PWM window.
    """
    run = []
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        inputs = {"time_s": row.time_s, "heater_duty": row.heater_duty, "fan_on": row.fan_on}
        run.append(chamber.sense() | inputs)
        if following is not None:
            drive(chamber, following.time_s - row.time_s, row)
    return run


def drive(chamber: Chamber, duration_s: int, row: RecordedRow) -> None:
    """Hold a row's inputs; the relay is closed for the first duty * 20 s of each window."""
    closed_s = round(row.heater_duty * WINDOW_S)
    for _ in range(0, duration_s, WINDOW_S):
        chamber.step(closed_s, 1.0, bool(row.fan_on), row.light, False)
        chamber.step(WINDOW_S - closed_s, 0.0, bool(row.fan_on), row.light, False)
