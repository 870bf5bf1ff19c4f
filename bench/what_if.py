"""python -m bench.what_if: the twin's answers to *what if* beside boxes that really have the other heater.

Each box is commissioned by step tests of two hours. Its twin is asked for now, for half as much heater again
and for walls of twice the thickness; in the virtual board's chamber also for half the fan. Then the box gets
what was asked for. Neither the chamber nor the boxes of `bench.boxes` share code with the twin. A row tells
the interval, the truth, and whether it holds. Widths are in shares of the middle, which for a temperature is
counted from the room.
"""

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from bench.boxes.__main__ import commission, rig_settings
from bench.boxes.draw import BURNT, LOTS, draw_box
from bench.boxes.facts import MATERIALS, BoxFacts
from bench.boxes.physics import BoxPhysics
from bench.boxes.reach import Still
from bench.header import header
from edge.app.commission import learn
from edge.app.step_test_record import record, test_settings
from edge.app.what_if import Outlook, Quantity, TwinChange, WhatIf, outlooks
from edge.config.settings import ControlSettings
from edge.core.errors import GreenhouseError, RequestError
from edge.twin.new_file import FILM_M2_K_W, BoxDescription, text
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import Effects
from training.lab import InProcessBoard

TIMES, THICKER = 1.5, 2.0  # the present heater and walls
# Boxes by which the doubts of `edge.app.what_if` were chosen, and those that were asked when these stood.
KNOWN = (*LOTS[0], 101, 102)
NEW = (*LOTS[1][2:], *LOTS[2][:BURNT])
TARGET_SHARE = 0.6  # of the rise at full heat, for boxes that reach other temperatures
SHEETS_U = (3.3, 2.4)  # twin-wall polycarbonate of 8 and 16 mm, makers' figures [W/m2K]
STANDARD_FILMS = 0.17  # that these figures include [m2 K/W]
CHAMBER_TARGET_C = 35.0
CHAMBER_W, CHAMBER_FAN_M3_H, CHAMBER_M3 = 100.0, 68.0, 0.15
MINUTES, DAY_S = 120.0, 86_400.0
CLOSE = 1e-3  # of the heater's power, where a search for it ends
QUIET = {
    name: 0.0
    for name in (
        "ambient_diurnal",
        "ambient_wander",
        "power_run_variation",
        "power_wander",
        "sensor_noise",
        "sensor_step",
    )
}
ALL = "all"
KEYS = ("reach_c", "warm_up_min", "power_w", "cooling_min")


@dataclass(frozen=True, slots=True)
class TrueOutlook:
    """The behaviour of a box, by the keys of an outlook; NaN where it was not tried."""

    reach_c: float
    warm_up_min: float
    power_w: float
    cooling_min: float = float("nan")


class CheckedInterval(NamedTuple):
    """An interval beside the truth. width : of its middle, a temperature's counted from the room"""

    change: str
    key: str
    holds: bool
    width: float


@dataclass(frozen=True, slots=True)
class BoxAnswers:
    """Lines to print, and how each interval did."""

    lines: list[str]
    held: list[CheckedInterval]


def chamber_answers(seed: int, twins: Path | None = None) -> BoxAnswers:
    """Commission the chamber and compare. twins : folder with twins of an earlier run, and for this one's"""
    parameters, effects = load()
    twin = _take_or_fit(twins, f"chamber_{seed}", partial(_chamber_twin, seed))
    factor = SHEETS_U[1] / SHEETS_U[0]
    resistance = 1.0 / SHEETS_U[1] - STANDARD_FILMS
    gap = replace(parameters.cover, gap_w_m2_k=1.0 / resistance)
    heater = replace(parameters.heater, power_w=TIMES * parameters.heater.power_w)
    fan = replace(parameters.fan, flow_m3_s=0.5 * parameters.fan.flow_m3_s)
    cases = {
        "now": (TwinChange(), parameters),
        f"heater x {TIMES:g}": (TwinChange(heater_w=TIMES * CHAMBER_W), replace(parameters, heater=heater)),
        f"walls x {factor:.2f}": (TwinChange(wall_factor=factor), replace(parameters, cover=gap)),
        "fan x 0.5": (TwinChange(fan=0.5), replace(parameters, fan=fan)),
    }
    room_c = _room_shown(parameters, effects)
    held: list[CheckedInterval] = []
    lines = [f"chamber, seed {seed}: {', '.join(twin.effects)}; target {CHAMBER_TARGET_C:g} °C"]
    for name, (change, other) in cases.items():
        truth = _chamber_truth(other, replace(effects, **QUIET))
        told = _outlook_of(twin, change, CHAMBER_TARGET_C, room_c)
        keys = KEYS if change.fan is None else KEYS[-1:]
        lines += _compare(name, told, truth, keys, room_c, held)
    return BoxAnswers(lines, held)


def box_answers(number: int, twins: Path | None = None) -> BoxAnswers:
    """Commission a box of `bench.boxes` and compare. twins : as of `chamber_answers`"""
    facts = draw_box(number)
    try:
        twin = _take_or_fit(twins, f"box_{number}", partial(_box_twin, facts))
    except GreenhouseError as error:
        return BoxAnswers([f"box {number}, {facts.kind}: not commissioned: {error}"], [])
    return answers_of(facts, twin)


def answers_of(facts: BoxFacts, twin: TwinFile) -> BoxAnswers:
    """Ask the twin of a box and compare."""
    sensor = facts.room_sensor
    room_c = ControlSettings().ambient_default_c if sensor is None else facts.room.mean_c + sensor.bias
    full_c = _reading(facts, 1.0)
    target_c = room_c + TARGET_SHARE * (full_c - room_c)
    held: list[CheckedInterval] = []
    lines = [f"box {facts.seed}, {facts.kind}: {', '.join(twin.effects)}; target {target_c:.1f} °C"]
    resistance = sum(layer.thickness_m / MATERIALS[layer.material].conductivity_w_m_k for layer in facts.wall)
    factor = (FILM_M2_K_W + resistance) / (FILM_M2_K_W + THICKER * resistance)
    thicker = tuple(replace(layer, thickness_m=THICKER * layer.thickness_m) for layer in facts.wall)
    heater_w = TIMES * facts.heater_w
    cases = {
        "now": (TwinChange(), facts),
        f"heater x {TIMES:g}": (TwinChange(heater_w=heater_w), replace(facts, heater_w=heater_w)),
        f"walls x {factor:.2f}": (
            TwinChange(wall_factor=factor, wall_thickness=2.0),
            replace(facts, wall=thicker),
        ),
    }
    for name, (change, other) in cases.items():
        truth = _box_truth(other, target_c)
        try:
            told = _outlook_of(twin, change, target_c, room_c)
        except RequestError as error:
            lines.append(f"    {name}: {error}")
            continue
        lines += _compare(name, told, truth, KEYS[:3], room_c, held)
    return BoxAnswers(lines, held)


def _outlook_of(twin: TwinFile, change: TwinChange, target_c: float, room_c: float) -> Outlook:
    now, changed = outlooks(twin, WhatIf(change, target_c, room_c, room_c, target_c, 0.0), 1.0)
    return changed or now


def _compare(
    name: str,
    told: Outlook,
    truth: TrueOutlook,
    keys: Sequence[str],
    room_c: float,
    held: list[CheckedInterval],
) -> Iterator[str]:
    for key in keys:
        said, true = getattr(told, key), getattr(truth, key)
        assert isinstance(said, Quantity)
        holds = said.low <= true <= said.high
        middle = said.value - room_c if key == KEYS[0] else said.value
        width = (said.high - said.low) / middle if math.isfinite(said.high) else math.inf
        held.append(CheckedInterval(name.split()[0], key, holds, width))
        yield (
            f"    {name:<14}{key:<13}{said.low:8.1f} to {said.high:6.1f}, median {said.value:6.1f}; "
            f"true {true:6.1f}{'' if holds else '  outside'}"
        )


def _summary(kind: str, rows: Sequence[CheckedInterval]) -> Iterator[str]:
    """Yield how many hold, by change, by key and in all, and how wide they are."""
    names = dict.fromkeys([*(row.change for row in rows), *(row.key for row in rows), ALL])
    for name in names:
        own = [row for row in rows if name in (row.change, row.key, ALL)]
        holds, width = sum(row.holds for row in own), np.median([row.width for row in own])
        yield f"{kind}: {name}: {holds} of {len(own)} intervals of 90 % hold; median width {width:.2f}"


def _take_or_fit(twins: Path | None, name: str, fit: Callable[[], TwinFile]) -> TwinFile:
    """Return the twin of an earlier run, or fit it and keep it for the next one."""
    path = None if twins is None else twins / f"{name}.yaml"
    if path is not None and path.exists():
        return read_twin_file(path)
    twin = fit()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_twin_file(twin, path)
    return twin


def _box_twin(facts: BoxFacts) -> TwinFile:
    found = commission(facts, facts.seed, MINUTES)
    if found.refusals:
        raise RequestError(f"refused: {found.refusals[0]}")
    return found.twin


def _chamber_twin(seed: int) -> TwinFile:
    with tempfile.TemporaryDirectory(prefix="what-if-") as temporary:
        folder = Path(temporary)
        described = folder / "described.yaml"
        described.write_text(text(BoxDescription(CHAMBER_M3, CHAMBER_W, "exhaust", CHAMBER_FAN_M3_H)))
        start, board = read_twin_file(described), InProcessBoard(seed)
        settings = test_settings(rig_settings(folder, start))
        run = record(settings, board, True, MINUTES, open_port=board.open)
    return learn(run, start, ControlSettings(), lambda text, share: None).twin


@lru_cache  # quiet chambers of all seeds are the same
def _chamber_truth(parameters: ChamberParameters, effects: Effects) -> TrueOutlook:
    def after_a_day(share: float) -> Chamber:
        chamber = Chamber(parameters, effects, 1)
        chamber.step(DAY_S, share, False, 0.0, False)
        return chamber

    warm_up_s = _until(Chamber(parameters, effects, 1), 1.0, False, CHAMBER_TARGET_C, 1.0)
    share = _share_to_hold(lambda share: after_a_day(share).sense()["temp_air_c"], CHAMBER_TARGET_C)
    warm = after_a_day(share)
    begin_c, room_c = (warm.sense()[key] for key in ("temp_air_c", "temp_ambient_c"))
    cooling_s = _until(warm, 0.0, True, 0.5 * (begin_c + room_c), -1.0)
    return TrueOutlook(
        after_a_day(1.0).sense()["temp_air_c"],
        warm_up_s / 60.0,
        share * parameters.heater.power_w,
        cooling_s / 60.0,
    )


def _share_to_hold(air_c: Callable[[float], float], target_c: float) -> float:
    """Return the share of full heat at which the air ends at the target."""
    return float(brentq(lambda share: air_c(share) - target_c, 0.0, 1.0, xtol=CLOSE))


def _until(chamber: Chamber, heater: float, fan: bool, target_c: float, sign: float) -> float:
    """Return the time until the sensor shows a temperature, infinite where not in a day [s]."""
    begin_s = chamber.truth()["time_s"]
    while sign * chamber.sense()["temp_air_c"] < sign * target_c:
        chamber.step(1.0, heater, fan, 0.0, False)
        if chamber.truth()["time_s"] - begin_s > DAY_S:
            return float("inf")
    return chamber.truth()["time_s"] - begin_s


def _room_shown(parameters: ChamberParameters, effects: Effects) -> float:
    return Chamber(parameters, replace(effects, **QUIET), 1).sense()["temp_ambient_c"]


def _box_truth(facts: BoxFacts, target_c: float) -> TrueOutlook:
    physics = BoxPhysics(facts, Still(facts.room.mean_c))
    times, states = physics.warm_up(facts.room.mean_c, 1.0)
    air = physics.reading_c(states)
    after = np.argmax(air >= target_c)
    return TrueOutlook(
        float(air[-1]),
        float(np.interp(target_c, air[: after + 1], times[: after + 1])) / 60.0,
        _share_to_hold(partial(_reading, facts), target_c) * facts.heater_w,
    )


def _reading(facts: BoxFacts, share: float) -> float:
    physics = BoxPhysics(facts, Still(facts.room.mean_c))
    return float(physics.reading_c(physics.rest(facts.room.mean_c, share))[0])


def main(words: Sequence[str] | None = None) -> int:
    """Print the rows, and how many intervals held."""
    parser = argparse.ArgumentParser(prog="python -m bench.what_if", description=__doc__)
    parser.add_argument(
        "--seeds", type=int, nargs="*", default=(1, 2, 3), help="of the chamber; default: 1 2 3"
    )
    parser.add_argument(
        "--boxes",
        type=int,
        nargs="*",
        default=(*KNOWN, *NEW),
        help="of bench.boxes; default: those known and new",
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes; default: 2")
    parser.add_argument(
        "--twins", type=Path, help="folder: twins of an earlier run are taken from here, new ones kept"
    )
    given = parser.parse_args(words)
    print("\n".join(header()), flush=True)
    held: dict[str, list[CheckedInterval]] = {}
    known, new = ([n for n in given.boxes if (n in KNOWN) is is_known] for is_known in (True, False))
    with ProcessPoolExecutor(given.jobs) as pool:
        for kind, call, numbers in (
            ("chamber", chamber_answers, given.seeds),
            ("known boxes", box_answers, known),
            ("new boxes", box_answers, new),
        ):
            for found in pool.map(partial(call, twins=given.twins), numbers):
                print("\n".join(found.lines), flush=True)
                held.setdefault(kind, []).extend(found.held)
    for kind, rows in held.items():
        print("\n".join(_summary(kind, rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
