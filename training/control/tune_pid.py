"""Gains of the PID, chosen on the tuning references: `python -m training.control.tune_pid`.

A grid of gains, each with a box of its own in `ChamberRows`; the sensor shows no noise here. Cost with
weight 0 by what the sensor shows, seeds of the board from 101 on: the comparison's references and seeds
have no say.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from edge.controllers.base import Context, Limits
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.pid import Pid
from edge.messages import Command, Estimate
from edge.names import HEATER_LEVELS
from edge.profile_file import read_profile
from edge.reference import reference_from_profile
from firmware_protocol.virtual_board.chamber_parameters import load
from training.control.chamber_rows import Boxes, ChamberRows
from training.control.clairvoyant import COARSE_S, relay_share
from training.control.draw_references import FOLDER

Floats = NDArray[np.float64]
KPS = (0.2, 0.4, 0.6, 0.8, 1.2, 1.6)  # [1/K]
KIS = (0.0, 0.0001, 0.0002, 0.0004, 0.0008, 0.0016)  # [1/(K s)]
KDS = (0.0, 20.0, 40.0, 60.0, 90.0, 120.0)  # [s/K]
CASES = (("tuning_1", 101), ("tuning_2", 102))
STEP_S = 60.0
ROOM_C = 21.0  # a PID does not look at it


def costs(pids: list[Pid], reference: Floats, seed: int) -> Floats:
    """Tracking cost of each [B] over a reference [N]."""
    chamber = ChamberRows(*load(), seed)
    boxes, cost = chamber.start(len(pids)), np.zeros(len(pids))
    sent = [Command()] * len(pids)
    for k, target in enumerate(reference):
        shown = chamber.shown(boxes)
        sent = [
            pid.decide(_context(k, float(temp), float(target), last)).command
            for pid, temp, last in zip(pids, shown, sent, strict=True)
        ]
        boxes = _minute(chamber, boxes, k * STEP_S, sent)
        cost += TRACKING_WEIGHT * (chamber.shown(boxes) - target) ** 2
    return cost


def _context(k: int, temp: float, target: float, last: Command) -> Context:
    now = k * STEP_S
    estimate = Estimate(temp, 0.0, 0.0, None, ROOM_C, now)
    return Context(now, now, STEP_S, {}, estimate, np.full(1, target), last, Limits())


def _minute(chamber: ChamberRows, boxes: Boxes, begin_s: float, sent: list[Command]) -> Boxes:
    levels = np.array([round(command.heater_duty * HEATER_LEVELS) for command in sent])
    fan = np.array([float(command.fan_on) for command in sent])
    for part in range(round(STEP_S / COARSE_S)):
        time_s = begin_s + part * COARSE_S
        boxes = chamber.step(boxes, time_s, COARSE_S, relay_share(time_s, COARSE_S, levels), fan)
    return boxes


def main() -> None:
    """Print the ten best."""
    gains = list(itertools.product(KPS, KIS, KDS))
    total = np.zeros(len(gains))
    for name, seed in CASES:
        path = FOLDER / f"{name}.csv"
        times = STEP_S * np.arange(int(read_profile(path).end_s / STEP_S))
        total += costs([Pid(*each) for each in gains], reference_from_profile(path).at(times, times), seed)
    print("cost      kp [1/K]  ki [1/(K s)]  kd [s/K]")
    for place in np.argsort(total)[:10]:
        kp, ki, kd = gains[place]
        print(f"{total[place]:8.0f}  {kp:8g}  {ki:12g}  {kd:8g}")


if __name__ == "__main__":
    main()
