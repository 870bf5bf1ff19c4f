"""A closed-loop day on the virtual board: `python -m bench.closed_loop_day`.

Reference steps by day and a low night, the lamp on from 06:00 to 22:00, the whole daemon in lock-step with
the board's process. Every controller gets the same rooms (seeds). Prints a table, keeps it and a picture.
"""

import argparse
import platform
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from bench.closed_loop_picture import draw
from edge.config import loading as config
from edge.core.controller import MPC, RULES
from edge.core.names import HEATER_MAX_W
from edge.core.version import __version__
from edge.models.arx_file import read_arx
from training.control.closed_loop import closed_loop, log_of

Floats = NDArray[np.float64]
RESULT = Path(__file__).parent / "results" / "closed_loop_day.txt"
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "closed_loop_day.png"
SETTLE_MIN = 30  # after each change of the reference, left out of the "settled" columns
NEAR_K = 0.5
COMPARED = (RULES, *MPC)
DEFAULT = config.default().control.controller  # the one that is drawn

DAY_YAML = """
timezone: UTC
reference:
  kind: daily
  daily:
    - {at: "00:00", reference_c: 23}
    - {at: "06:00", reference_c: 26}
    - {at: "08:00", reference_c: 28}
    - {at: "10:00", reference_c: 25.5}
    - {at: "12:00", reference_c: 30}
    - {at: "15:00", reference_c: 27}
    - {at: "18:00", reference_c: 29}
    - {at: "20:00", reference_c: 26}
    - {at: "22:00", reference_c: 23}
lighting: {enabled: true, on: "06:00", off: "22:00", level: 0.5}
"""
CHAMBER = {"room": {"start_hour": 0}}  # the simulated day begins at midnight, as the board's process does


@dataclass(frozen=True, slots=True)
class Day:
    """One controller's day on one seed: columns with a row per tick, and what was counted."""

    controller: str
    seed: int
    columns: Mapping[str, Floats]
    changes: Counter[str]  # safety rule -> commands it changed
    time_boxes: int  # decisions that the wall clock cut short
    heater_off_at_end: bool
    plans: tuple[tuple[float, ...], ...] = ()  # as in `training.control.closed_loop.Log`

    @property
    def errors(self) -> tuple[Floats, Floats]:
        """Measured and true air temperature at the end of each step, less its reference [K]."""
        reference = self.columns["reference_c"][:-1]
        return self.columns["temp_air_c"][1:] - reference, self.columns["true_air_c"][1:] - reference

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Steps that are not within SETTLE_MIN of a change of the reference."""
        reference = self.columns["reference_c"][:-1]
        settled = np.ones(len(reference), dtype=bool)
        for change in np.flatnonzero(np.diff(reference, prepend=np.nan) != 0.0):
            settled[change : change + SETTLE_MIN] = False
        return settled


def run_day(controller: str, seed: int, hours: float, yaml: str = DAY_YAML) -> Day:
    """Run the daemon with `controller` on a virtual board with `seed`, from midnight on."""
    settings = config.parse(yaml, "closed_loop_day")
    settings = replace(settings, control=replace(settings.control, controller=controller))
    with closed_loop(settings, seed=seed, chamber=CHAMBER) as lab:
        lab.run(minutes=60.0 * hours)
        heater_off = not lab.board.truth()["pins"]["heater_relay"]
    log = log_of(lab)
    return Day(controller, seed, log.columns, log.changes, log.time_boxes, heater_off, log.plans)


TITLES = {  # column -> width; the safety changes stand after the last one
    "seed": 4, "MAE": 6, "true": 6, "settled": 7, "true, settled": 13, "near": 5, "near, settled": 13,
    "heat": 5, "fan": 5, "switches": 8, "travel": 6, "median": 6, "longest": 7, "box": 4,
}  # fmt: skip
HEADER = "  ".join(["controller", *(f"{name:>{width}s}" for name, width in TITLES.items()), "safety changes"])


def table_line(day: Day) -> str:
    """One day in numbers."""
    measured, true = (np.abs(errors) for errors in day.errors)
    columns, settled = day.columns, day.settled
    step_h = float(np.median(np.diff(columns["time_s"]))) / 3600.0
    values = (
        str(day.seed),
        *(f"{np.nanmean(errors):.3f}" for errors in (measured, true, measured[settled], true[settled])),
        *(f"{100.0 * np.mean(errors < NEAR_K):.1f}" for errors in (measured, measured[settled])),
        f"{columns['heater_duty'].sum() * HEATER_MAX_W * step_h:.0f}",
        f"{columns['fan_on'].sum() * step_h * 60.0:.0f}",
        f"{np.abs(np.diff(columns['fan_on'])).sum():.0f}",
        f"{np.abs(np.diff(columns['heater_duty'])).sum():.1f}",
        f"{np.median(columns['solve_ms']):.1f}",
        f"{np.max(columns['solve_ms']):.0f}",
        str(day.time_boxes),
    )
    cells = [f"{value:>{width}s}" for value, width in zip(values, TITLES.values(), strict=True)]
    rules = ", ".join(f"{rule} {count}" for rule, count in sorted(day.changes.items())) or "none"
    return "  ".join([f"{day.controller:<10s}", *cells, rules])


def _facts(command: str) -> list[str]:
    model = read_arx()
    orders = f"ARX p = {len(model.temp)}, q = {len(model.heater)} ({model.version})"
    versions = f"Python {platform.python_version()}, numpy {np.__version__}"
    return [
        f"# {command}",
        f"# greenhouse-twin {__version__}, {orders}, {versions}",
        "# MAE: mean |air at the end of a step - its reference| [K], by the measurement; true: in the",
        "# simulated box, whose sensor reads 0.4 K high (its class is +-0.5 K); near: share of steps",
        f"# within 0.5 K, measured [%]; settled: without the first {SETTLE_MIN} min after each change of",
        "# the reference; heat [Wh]; fan [min]; travel: sum of |change of duty|; median and longest",
        "# solve [ms of wall clock, on a shared machine]; box: decisions that the wall clock cut short.",
    ]


def main(words: Sequence[str] | None = None) -> None:
    """Run all days, print and save the table, draw the default controller's first seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of the virtual board")
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--controllers", nargs="+", choices=COMPARED, default=list(COMPARED))
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument("--picture", type=Path, default=PICTURE)
    words = sys.argv[1:] if words is None else words
    arguments = parser.parse_args(words)
    for path in (arguments.out, arguments.picture):
        path.parent.mkdir(parents=True, exist_ok=True)
    drawn = None
    with arguments.out.open("w", encoding="utf-8") as kept:
        for line in [*_facts(" ".join(["python -m bench.closed_loop_day", *words])), HEADER]:
            _tell(line, kept)
        for controller in arguments.controllers:
            for seed in arguments.seeds:
                day = run_day(controller, seed, arguments.hours)
                _tell(table_line(day), kept)
                if seed == arguments.seeds[0] and (drawn is None or controller == DEFAULT):
                    drawn = day
    if drawn is not None:
        draw(drawn, arguments.picture)


def _tell(line: str, kept: TextIO) -> None:
    """At once: a day takes a minute or more, and what is done shall not be lost."""
    print(line, flush=True)
    print(line, file=kept, flush=True)


if __name__ == "__main__":
    main()
