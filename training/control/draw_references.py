"""The references of the comparison, from lists of segments: `python -m training.control.draw_references`.

1 and 2 are what controllers are compared on; `tuning_1` to `tuning_3` what gains and weights are chosen on.
All lie between 23 and 34 degC: the room is up to 22, the fan can't cool below it, 100 W reach about 38.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent / "references"
ROW_S = 60  # of a ramp: one row per control step


@dataclass(frozen=True, slots=True)
class Hold:
    """A constant target."""

    minutes: int
    reference_c: float


@dataclass(frozen=True, slots=True)
class Slope:
    """A line from the target before to this one."""

    minutes: int
    reference_c: float


SEGMENTS: dict[str, tuple[Hold | Slope, ...]] = {
    "reference_1": (
        Hold(20, 24.0), Hold(35, 28.0), Slope(30, 31.0), Hold(20, 31.0), Hold(25, 27.0), Hold(22, 25.0),
        Slope(20, 30.0), Hold(20, 30.0), Hold(20, 26.0),
    ),
    "reference_2": (
        Hold(120, 23.5), Slope(120, 27.0), Hold(90, 27.0), Hold(60, 30.0), Hold(90, 28.0), Slope(90, 32.0),
        Hold(60, 32.0), Hold(60, 29.0), Hold(90, 25.0), Hold(45, 31.0), Hold(45, 26.0), Slope(120, 33.5),
        Hold(30, 33.5), Slope(150, 26.0), Hold(60, 28.5), Slope(120, 24.0), Hold(90, 24.0),
    ),
    "tuning_1": (
        Hold(30, 26.0), Slope(40, 29.0), Hold(25, 29.0), Hold(35, 32.0), Slope(25, 27.5), Hold(25, 24.5),
        Hold(40, 27.0),
    ),
    "tuning_2": (
        Hold(60, 25.0), Hold(60, 29.5), Slope(60, 26.0), Hold(45, 26.0), Slope(90, 31.5), Hold(45, 33.0),
        Hold(60, 28.0), Hold(40, 30.0), Slope(60, 24.5), Hold(60, 24.5),
    ),
    "tuning_3": (  # down again and again: what the fan is for
        Hold(25, 26.0), Hold(30, 30.0), Hold(25, 26.5), Slope(25, 29.5), Hold(20, 29.5), Hold(30, 25.5),
        Hold(25, 29.0), Hold(20, 25.0),
    ),
}  # fmt: skip


def rows(segments: tuple[Hold | Slope, ...]) -> list[tuple[int, float]]:
    """Time [s] and target [degC], the last row at the end; each holds until the next."""
    drawn: list[tuple[int, float]] = []
    time_s, target = 0, segments[0].reference_c
    for segment in segments:
        length_s = segment.minutes * 60
        if isinstance(segment, Hold):
            drawn.append((time_s, segment.reference_c))
        else:
            steps = length_s // ROW_S
            line = np.linspace(target, segment.reference_c, steps + 1)[1:]
            drawn += [(time_s + k * ROW_S, float(value)) for k, value in enumerate(line)]
        time_s, target = time_s + length_s, segment.reference_c
    return [*drawn, (time_s, target)]


def text(name: str) -> str:
    """Return a reference as a profile file."""
    lines = [f"{time_s},{target:.6g}" for time_s, target in rows(SEGMENTS[name])]
    return "\n".join(["time_s,reference_c", *lines]) + "\n"


if __name__ == "__main__":
    for reference in SEGMENTS:
        (FOLDER / f"{reference}.csv").write_text(text(reference), encoding="utf-8")
