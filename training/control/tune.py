"""PID and thermostat settings from the tuning references: `python -m training.control.tune PID`.

A grid of settings, each with a chamber of its own in `ChamberRows`; the sensor shows no noise here. Cost with
weight 0 by what the sensor shows, seeds of the board from 101 on: the comparison's references and seeds have
no say.
"""

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.pid import FAN_ON_K, KD, KI, KP, Pid
from edge.controllers.rules import Rules, Thresholds
from edge.core.controller import Context, Controller, ControlLimits
from edge.core.messages import Command, Estimate
from edge.core.names import HEATER_LEVELS
from edge.formats.profile_file import read_profile
from edge.formats.table import Table
from edge.tick.reference import reference_from_profile
from firmware_protocol.virtual_board.chamber_parameters import load
from training.control.chamber_rows import BoxStates, ChamberRows
from training.control.clairvoyant import COARSE_S, relay_share
from training.control.draw_references import FOLDER

Floats = NDArray[np.float64]
Setting = tuple[float, ...]
CASES = (("tuning_1", 101), ("tuning_2", 102), ("tuning_3", 103))
STEP_S = 60.0
ROOM_C = 21.0  # neither of them looks at it
BEST = 10  # settings that are printed


@dataclass(frozen=True, slots=True)
class Grid:
    """Settings to try. heads : name and unit of each; shipped : the one in use"""

    make: Callable[..., Controller]
    heads: tuple[str, ...]
    values: tuple[Sequence[float], ...]
    shipped: Setting


GRIDS = {
    "PID": Grid(
        Pid,
        ("kp [1/K]", "ki [1/(K s)]", "kd [s/K]", "fan on [K]"),
        (
            (0.2, 0.4, 0.6, 0.8, 1.2, 1.6),
            (0.0, 0.0001, 0.0002, 0.0004, 0.0008, 0.0016),
            (0.0, 20.0, 40.0, 60.0, 90.0, 120.0),
            (0.5, 1.0, 1.5, 2.0),
        ),
        (KP, KI, KD, FAN_ON_K),
    ),
    "rules": Grid(
        lambda *each: Rules(Thresholds(*each)),
        ("heat below [K]", "until below [K]", "cool above [K]", "until above [K]"),
        (
            (-0.2, 0.0, 0.2, 0.5, 1.0),
            (-0.5, -0.2, 0.0, 0.2, 0.5, 1.0),
            (1.0, 1.5, 2.0, 2.5, 3.0, 4.0),
            (0.0, 0.3, 0.6, 1.0, 1.5),
        ),
        (
            Thresholds().heat_below_k,
            Thresholds().heat_until_k,
            Thresholds().cool_above_k,
            Thresholds().cool_until_k,
        ),
    ),
}


def costs(controllers: Sequence[Controller], reference: Floats, seed: int) -> Floats:
    """Return the tracking cost of each [B] over a reference [N]."""
    chamber = ChamberRows(*load(), seed)
    boxes, cost = chamber.start(len(controllers)), np.zeros(len(controllers))
    sent = [Command()] * len(controllers)
    for k, target in enumerate(reference):
        shown = chamber.reading(boxes)
        sent = [
            each.decide(_context(k, float(temp), float(target), last)).command
            for each, temp, last in zip(controllers, shown, sent, strict=True)
        ]
        boxes = _minute(chamber, boxes, k * STEP_S, sent)
        cost += TRACKING_WEIGHT * (chamber.reading(boxes) - target) ** 2
    return cost


def tune(grid: Grid) -> list[tuple[float, Setting]]:
    """Return cost and setting over all cases, the cheapest first."""
    settings = list(itertools.product(*grid.values))
    total = np.zeros(len(settings))
    for name, seed in CASES:
        path = FOLDER / f"{name}.csv"
        times = STEP_S * np.arange(int(read_profile(path).end_s / STEP_S), dtype=np.float64)
        reference = reference_from_profile(path).at(times, times)
        total += costs([grid.make(*each) for each in settings], reference, seed)
    return [(float(total[place]), settings[place]) for place in np.argsort(total, kind="stable")]


def _context(k: int, temp: float, target: float, last: Command) -> Context:
    now = k * STEP_S
    estimate = Estimate(temp, 0.0, 0.0, None, ROOM_C, now)
    return Context(now, now, STEP_S, {}, estimate, np.full(1, target), last, ControlLimits())


def _minute(chamber: ChamberRows, boxes: BoxStates, begin_s: float, sent: list[Command]) -> BoxStates:
    levels = np.array([round(command.heater_duty * HEATER_LEVELS) for command in sent])
    fan = np.array([float(command.fan_on) for command in sent])
    for part in range(round(STEP_S / COARSE_S)):
        time_s = begin_s + part * COARSE_S
        boxes = chamber.step(boxes, time_s, COARSE_S, relay_share(time_s, COARSE_S, levels), fan)
    return boxes


def main() -> None:
    """Print the best settings, and the one in use."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("controller", choices=GRIDS)
    grid = GRIDS[parser.parse_args().controller]
    found = tune(grid)
    shown = [*found[:BEST], next(one for one in found if one[1] == grid.shipped)]
    rows = tuple((f"{cost:.0f}", *(f"{value:g}" for value in setting)) for cost, setting in shown)
    note = "The last line is the setting in use."
    print("\n".join(Table("Settings", ("cost", *grid.heads), rows, note).text()))


if __name__ == "__main__":
    main()
