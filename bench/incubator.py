"""python -m bench incubator: a day in a small, quick box whose lid is opened at each step of the set point.

12 litres, a 60 W bulb that shines on the sensor, no fan, a room of 18 to 26 °C. The lid is open for 20 s from
the moment of each step. PID and rules know the description of `greenhouse setup`: volume and heater. The MPCs
have the models that `greenhouse commission` learnt in two hours of step tests. A row shows the hottest true
air, the mean error of the measurements, how often safety limited the heater, and the latches of daemon and
board.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.boxes.__main__ import install, rig_settings
from bench.header import header
from edge.app.commission import Commissioned, learn
from edge.app.step_test_record import record, test_settings
from edge.config.settings import ControlSettings, ReferenceSettings, ReferenceStep, SafetySettings, Settings
from edge.core.controller import Controller
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import TwinFile, read_twin_file
from firmware_protocol.virtual_board.board_config import RIG_PARTS
from firmware_protocol.virtual_board.chamber import Chamber, DoorSchedule
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.plant import Plant
from training.lab import InProcessBoard, Lab

BOX = {
    "box": {"width_m": 0.24, "depth_m": 0.2, "height_m": 0.25},
    "air": {"mixing_flow_m3_s": 0.004, "leak_flow_m3_s": 0.00002},
    # A bulb: 30 g of glass; most of its heat is light and infrared.
    "heater": {
        "power_w": 60.0, "capacity_j_k": 25.0, "surface_m2": 0.008, "view_soil": 0.3, "view_plant": 0.1,
    },
    "fan": {"flow_m3_s": 0.0, "motor_heat_w": 0.0},
    "soil": {"capacity_j_k": 400.0, "air_w_k": 0.2, "floor_w_k": 0.1, "longwave_m2": 0.02},
    "plant": {"capacity_j_k": 20.0, "leaf_m2": 0.005},
    "room": {"temp_c": 22.0, "diurnal_k": 3.7, "wander_sd_k": 0.1},
    "sensors": {"radiation_k_w": 0.05, "air_lag_s": 10.0},
    "effects": {"sensor_radiation": 1.0, "evapotranspiration": 0.1},
}  # fmt: skip
VOLUME_M3, HEATER_W = 0.012, 60.0
LID_S = 20.0
STEPS_C = (30.0, 37.0, 33.0, 38.0, 28.0, 35.0, 38.0, 31.0)  # of the set point, again and again
STEP_EVERY_S = 5400.0
DAY_MIN, TESTS_MIN = 1440.0, 120.0
TOLD = ("PID", "rules")  # that need no model
ROWS = (*TOLD, "MPC", "MPC-Twin-P")


class Lid(DoorSchedule):
    """A lid that opens for LID_S at given times, which rise. w_k : exchange with the room through it"""

    def __init__(self, opens_s: Sequence[float], w_k: float) -> None:
        self._times, self._w_k, self._count = [*opens_s, np.inf], w_k, -1
        self._next(0.0)

    def _next(self, now_s: float) -> None:
        self._count += 1
        self._opens_s = self._times[self._count]
        self._closes_s = self._opens_s + LID_S


class LiddedChamber(Chamber):
    """The virtual board's chamber as BOX, with a lid in place of its random door."""

    def __init__(self, seed: int, folder: Path, opens_s: Sequence[float] = ()) -> None:
        path = folder / "chamber.yaml"
        path.write_text(yaml.safe_dump(BOX))
        parameters, effects = load(path)
        super().__init__(parameters, effects, seed)
        self._door = Lid(opens_s, parameters.events.door_w_k)


@dataclass(frozen=True, slots=True)
class IncubatorRow:
    """One run. limited : ticks at which a safety rule held the heater back; latches : events of a trip"""

    hottest_c: float
    mae_k: float
    limited: Counter[str]
    latches: tuple[str, ...]


def box_description(folder: Path) -> TwinFile:
    """Return what a person would say of the box."""
    path = folder / "described.yaml"
    path.write_text(text(BoxDescription(VOLUME_M3, HEATER_W, "none", None)))
    return read_twin_file(path)


def settings_of(folder: Path, twin: TwinFile) -> Settings:
    """Return the settings that `greenhouse setup` would write for the box."""
    return replace(rig_settings(folder, twin), safety=SafetySettings())


def commission(seed: int) -> Commissioned:
    """Let the step tests learn the box, its lid shut. Errors: GreenhouseError"""
    with tempfile.TemporaryDirectory(prefix="incubator-") as temporary:
        folder = Path(temporary)
        start = box_description(folder)
        board = InProcessBoard(seed, plant=Plant(LiddedChamber(seed, folder), RIG_PARTS))
        run = record(test_settings(settings_of(folder, start)), board, False, TESTS_MIN, open_port=board.open)
    return learn(run, start, ControlSettings(), lambda text, share: None)


def drive(
    name: str, minutes: float, seed: int, found: Commissioned | None = None, instead: Controller | None = None
) -> IncubatorRow:
    """Run the box. found : models of those that plan; instead : a controller in place of the daemon's own"""
    with tempfile.TemporaryDirectory(prefix="incubator-") as temporary:
        folder = Path(temporary)
        settings = settings_of(folder, box_description(folder) if found is None else found.twin)
        times_s = [STEP_EVERY_S * k for k in range(int(60.0 * minutes / STEP_EVERY_S) + 1)]
        steps = tuple(ReferenceStep(at_s, STEPS_C[k % len(STEPS_C)]) for k, at_s in enumerate(times_s))
        settings = replace(
            settings,
            control=replace(settings.control, controller="rules" if instead else name, time_box_ms=60_000.0),
            reference=ReferenceSettings(kind="steps", steps=steps),
        )
        if found is not None:
            install(found, settings, folder)
        plant = Plant(LiddedChamber(seed, folder, times_s[1:]), RIG_PARTS)
        more: dict[str, Any] = {"more_controllers": [instead], "experiment": instead.name} if instead else {}
        lab = Lab(settings, board="here", plant=plant, seed=seed, folder=folder, with_truth=True, **more)
        with lab:
            lab.run(minutes=minutes)
        columns = lab.columns()
        rules = (change.rule for tick in lab.history for change in tick.changes)
        events = (event for tick in lab.history for event in tick.events)
        return IncubatorRow(
            float(columns["true_air_c"].max()),
            float(np.nanmean(np.abs(columns["temp_air_c"] - columns["reference_c"]))),
            Counter(rule for rule in rules if rule in ("heater.below_trip", "heater.over_temperature")),
            tuple(
                event.text for event in events if event.key in ("safety.over_temperature", "board.tripped")
            ),
        )


def main(words: Sequence[str] | None = None) -> int:
    """Print a row for each controller; 1 where a healthy box was latched."""
    parser = argparse.ArgumentParser(prog="python -m bench incubator", description=__doc__)
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS, help="default: all")
    parser.add_argument("--minutes", type=float, default=DAY_MIN, help="default: a day")
    parser.add_argument("--seed", type=int, default=1, help="default: 1")
    given = parser.parse_args(words)
    print("\n".join(header()))
    print(
        f"{given.minutes:g} min; hottest true air [°C], MAE [K], limits of safety [ticks], latches",
        flush=True,
    )
    found = commission(given.seed) if set(given.rows) - {*TOLD} else None
    latched = False
    for name in given.rows:
        row = drive(name, given.minutes, given.seed, None if name in TOLD else found)
        limits = ", ".join(f"{rule} {count}" for rule, count in row.limited.items()) or "none"
        print(
            f"{name:<11}{row.hottest_c:6.1f}{row.mae_k:6.2f}  {limits}; latches: {len(row.latches)}",
            flush=True,
        )
        latched |= bool(row.latches)
    return int(latched)


if __name__ == "__main__":
    raise SystemExit(main())
