"""python -m bench.boxes.days: days without a fault in commissioned boxes, then one fault after the other.

Without a fault every alarm is false. A fault's bound is the time until its name in the box's own twin, under
the same controller and safety, with a margin: the later one of the twin as it is and of one with a weaker
heater, for a twin is not exact. Nothing is promised of a fault that is not named in both.
PID is tuned on the twin (tuned_pid.py); rules are the fallback's.
"""

import argparse
import copy
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.boxes.__main__ import commission, rig_settings, tuning_courses
from bench.boxes.bodies import Body, BoxBody, TwinBody
from bench.boxes.draw import LOTS, draw_box
from bench.boxes.facts import BoxFacts
from bench.boxes.pilot import NOT_GOOD, Pilot, Task, fly
from bench.boxes.reach import scaled_reference
from bench.boxes.tuned_pid import tune_pid
from bench.header import header
from edge.app.box import box_bounds
from edge.config.settings import Settings
from edge.controllers.pid import Pid
from edge.controllers.rules import Rules
from edge.core.controller import Controller
from edge.core.errors import GreenhouseError
from edge.safety.box_bounds import BoxBounds
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file

HOUR_S = 3600.0
DAY = (
    (0.0, 0.1),
    (6.0, 0.6),
    (11.0, 0.95),
    (15.0, 0.7),
    (18.0, 0.5),
    (22.0, 0.1),
)  # hour, share of the reach
FAULT_H, LONGEST_H = 3.0, 6.0  # begin of a fault, and how long it may take
BOUND_TIMES, BOUND_S = 1.5, 120.0  # of the twin's time; two ticks
NOISE_SD_K = 0.05  # of a twin's sensor
HEATS = (1.0, 0.85)  # of the twin's heater
STUCK_ON = frozenset({"safety.heater_stuck_on", "safety.over_temperature"})
NO_HEAT = frozenset({"safety.heater_no_effect"})


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault and the names that are right for it.

    share : of the reach, that is held; after : of the reach, from the fault on; None: the same
    off : nothing is ordered from the fault on
    """

    name: str
    fault: str
    right: frozenset[str]
    share: float = 0.5
    after: float | None = None
    hour: float = FAULT_H
    off: bool = False
    offset_k: float = 0.0
    has_to: Callable[[BoxFacts], bool] = lambda facts: True

    def task(self, facts: BoxFacts) -> Task:
        """Return the case as a pilot's task."""
        shares = np.array([self.share, self.share if self.after is None else self.after])
        before_c, after_c = scaled_reference(shares, facts).tolist()
        fault_s = self.hour * HOUR_S
        return Task(
            lambda time_s: before_c if time_s <= fault_s else after_c,
            fault_s if self.off else np.inf,
            self.fault,
            fault_s,
            self.offset_k,
            self.right,
        )


def _exchanges(facts: BoxFacts) -> bool:
    return facts.fan == "exchange"


def _has_room(facts: BoxFacts) -> bool:
    return facts.room_sensor is not None


CASES = (
    FaultCase("relay stuck on, rig off", "heater_stuck_on", STUCK_ON, off=True),
    FaultCase("relay stuck on while held", "heater_stuck_on", STUCK_ON | {"safety.fan_no_effect"}),
    FaultCase("heater dead from the start", "heater_dead", NO_HEAT, hour=0.0, has_to=_has_room),
    FaultCase("heater dies while held", "heater_dead", NO_HEAT, has_to=_has_room),
    FaultCase(
        "fan stuck off, cooling asked for", "fan_stuck_off", frozenset({"safety.fan_no_effect"}),
        share=0.95, after=0.0, has_to=lambda facts: _exchanges(facts) and _has_room(facts),
    ),
    FaultCase(
        "fan stuck on, named as no heat", "fan_stuck_on", NO_HEAT, after=0.95,
        has_to=lambda facts: _exchanges(facts) and _has_room(facts),
    ),
    FaultCase("sensor stuck while held", "sensor_stuck", NO_HEAT | {NOT_GOOD}),
    FaultCase(
        "sensor 25 K too low from the start", "sensor_offset", NO_HEAT | {"safety.sensor_offset"},
        hour=0.0, offset_k=-25.0, has_to=_has_room,
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class BoxDays:
    """A box's lines. false : alarms without their fault; late : not named in their bound; seen : named"""

    lines: list[str]
    false: int = 0
    late: int = 0
    seen: int = 0


def measure(box: int, days: float, twins: Path | None) -> BoxDays:
    """Let days pass without a fault, then each fault. twins : folder of twin files, `8.yaml` of box 8"""
    facts = draw_box(box)
    try:
        twin = _twin_of(facts, box, twins)
    except GreenhouseError as error:
        return BoxDays([f"{box:3d} {facts.kind}: not commissioned: {error}"])
    rig = _Rig.of(facts, twin)
    days_lines, alarms = _days(rig, box, days)
    fault_lines, wrong, late, seen = _faults(rig, box)
    return BoxDays([f"{box:3d} {facts.kind}", *days_lines, *fault_lines], alarms + wrong, late, seen)


@dataclass(frozen=True, slots=True, eq=False)
class _Rig:
    """Parts that the pilots of one box share."""

    facts: BoxFacts
    twin: TwinFile
    settings: Settings
    bounds: BoxBounds
    pid: Pid

    @classmethod
    def of(cls, facts: BoxFacts, twin: TwinFile) -> "_Rig":
        with TemporaryDirectory(prefix="days-") as temporary:
            settings = rig_settings(Path(temporary), twin)
            courses = tuning_courses(facts, Path(temporary))
        pid = tune_pid(twin.twin(), facts.room.mean_c, courses, facts.fan == "exchange")
        return cls(facts, twin, settings, box_bounds(twin), pid)

    def pilot(self, controller: Controller, task: Task) -> Pilot:
        return Pilot(self.settings, self.bounds, copy.deepcopy(controller), task)


def _days(rig: _Rig, box: int, days: float) -> tuple[list[str], int]:
    """Return a line per controller, and the alarms of all."""
    pilots = [rig.pilot(own, Task(_day(rig.facts))) for own in (rig.pid, Rules())]
    fly(BoxBody(rig.facts, box + 2000, len(pilots)), pilots, 24.0 * HOUR_S * days)
    lines = []
    for pilot in pilots:
        counts = Counter(key for _, key in pilot.alarms).items()
        told = ", ".join(f"{count} {key}" for key, count in counts) or "no alarm"
        off_k = float(np.abs(pilot.off_by_k).mean())
        lines.append(f"    {pilot.controller.name:<6}{days:g} days: {told}; {off_k:.2f} K off in the mean")
    return lines, sum(len(pilot.alarms) for pilot in pilots)


def _faults(rig: _Rig, box: int) -> tuple[list[str], int, int, int]:
    """Return a line per fault, wrong names, faults not named in their bound, and faults named."""
    facts = rig.facts
    cases = [case for case in CASES if case.has_to(facts)]
    body = BoxBody(facts, box + 3000, len(cases))
    twins = [
        TwinBody(rig.twin.twin(), facts.room.mean_c, _has_room(facts), NOISE_SD_K, len(cases), heat)
        for heat in HEATS
    ]
    flights = [[rig.pilot(rig.pid, case.task(facts)) for case in cases] for _ in range(1 + len(twins))]
    bodies: list[Body] = [body, *twins]
    for flown, pilots in zip(bodies, flights, strict=True):
        fly(flown, pilots, HOUR_S * (FAULT_H + LONGEST_H))
    of_box, of_twins = flights[0], flights[1:]
    lines, late = [], 0
    for case, found, *promised in zip(cases, of_box, *of_twins, strict=True):
        bound_s = _bound_s(promised)
        is_late = bound_s is not None and not (found.named_s is not None and found.named_s <= bound_s)
        late += is_late
        after = "-" if found.named_s is None else f"{found.named_s / 60.0:.0f}"
        bound = "not seen in the twin" if bound_s is None else f"bound {bound_s / 60.0:.0f}"
        wrong = "".join(f"; false: {key} at {time_s / 60.0:.0f}" for time_s, key in found.wrong)
        hottest = f"  {found.hottest_c:.0f} °C"
        lines.append(f"    {case.name:36}{after:>5}  {bound}{hottest}{'  LATE' if is_late else ''}{wrong}")
    return (
        lines,
        sum(map(bool, [pilot.wrong for pilot in of_box])),
        late,
        sum(pilot.named_s is not None for pilot in of_box),
    )


def _bound_s(promised: Sequence[Pilot]) -> float | None:
    """Return the time in which a fault is named, by pilots of twins; None where one did not name it [s]."""
    times = [pilot.named_s for pilot in promised]
    named = [time_s for time_s in times if time_s is not None]
    return BOUND_TIMES * max(named) + BOUND_S if len(named) == len(times) else None


def _twin_of(facts: BoxFacts, box: int, twins: Path | None) -> TwinFile:
    """Return a saved twin, or commission the box, and save it where there is a folder."""
    path = None if twins is None else twins / f"{box}.yaml"
    if path is not None and path.exists():
        return read_twin_file(path)
    found = commission(facts, box, 120.0)
    if found.refusals:
        raise GreenhouseError("; ".join(found.refusals))
    if path is not None:
        write_twin_file(found.twin, path)
    return found.twin


def _day(facts: BoxFacts) -> Callable[[float], float]:
    hours, shares = np.array(DAY).T
    levels = scaled_reference(shares, facts)

    def reference_c(time_s: float) -> float:
        return float(levels[np.searchsorted(hours, time_s / HOUR_S % 24.0, side="right") - 1])

    return reference_c


def main(words: Sequence[str] | None = None) -> int:
    """Print a table per box, and what they come to."""
    parser = argparse.ArgumentParser(prog="python -m bench.boxes.days", description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", default=LOTS[0], help="of bench.boxes.draw")
    parser.add_argument("--days", type=float, default=3.0, help="without a fault; default: 3")
    parser.add_argument("--twins", type=Path, help="folder of twin files; a missing one is made")
    parser.add_argument("--jobs", type=int, default=2, help="processes; default: 2")
    given = parser.parse_args(words)
    print("\n".join(header()))
    print("minutes from a fault until its name, the bound by the twin, the hottest air", flush=True)
    results = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for job in [pool.submit(measure, box, given.days, given.twins) for box in given.boxes]:
            results.append(job.result())
            print("\n".join(results[-1].lines), flush=True)
    false, late, seen = (sum(getattr(one, name) for one in results) for name in ("false", "late", "seen"))
    print(f"false alarms: {false}; faults named: {seen}; promised and not named in their bound: {late}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
