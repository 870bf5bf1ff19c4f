"""A pilot of one body: readings, a controller and safety, as in a tick, with faults between.

Pilots fly in a row over the columns of one body, which costs hardly more than one of them alone. The daemon's
own parts judge: `SensorHealth`, `supervise`. The board and its line are not between them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.boxes.bodies import SAMPLE_S, SAMPLES, STEP_S, Body
from edge.config.settings import Settings
from edge.core.controller import Context, Controller
from edge.core.messages import Command, Echo, Estimate, Reading, ReadingQuality
from edge.safety.box_bounds import BoxBounds
from edge.safety.supervisor import SafetyMemory, SafetyView, planning_limits, supervise
from edge.tick.sensor_health import SensorHealth

NOT_GOOD = "reading.not_good"


@dataclass(frozen=True, slots=True)
class Task:
    """A pilot's orders.

    reference_c : of a time [s]; off_s : from then on nothing is ordered
    fault, offset_k : of firmware_protocol.virtual_board.faults.KINDS, from fault_s on
    right : names of alarms that the fault may have
    """

    reference_c: Callable[[float], float]
    off_s: float = np.inf
    fault: str = ""
    fault_s: float = np.inf
    offset_k: float = 0.0
    right: frozenset[str] = frozenset()


@dataclass(slots=True)
class Pilot:
    """State from tick to tick. alarms : when [s], and which: an event of safety, or a reading not good"""

    settings: Settings
    bounds: BoxBounds
    controller: Controller
    task: Task
    alarms: list[tuple[float, str]] = field(default_factory=list)
    off_by_k: list[float] = field(default_factory=list)  # shown air minus reference, by tick
    hottest_c: float = -np.inf  # as a sensor without fault shows it
    sent: Command = field(default_factory=Command)
    _memory: SafetyMemory = field(default_factory=SafetyMemory)
    _health: SensorHealth = field(init=False)
    _stuck_c: float = np.nan
    _was_good: bool = True

    def __post_init__(self) -> None:
        self._health = SensorHealth(self.settings.sensor_health, self.settings.calibration, self.bounds)
        self.controller.reset()

    @property
    def named_s(self) -> float | None:
        """Return the time from the fault until its name, None before it [s]."""
        times = (time_s for time_s, key in self.alarms if key in self.task.right)
        return next((time_s - self.task.fault_s for time_s in times if time_s > self.task.fault_s), None)

    @property
    def wrong(self) -> list[tuple[float, str]]:
        """Return the alarms that are not right, up to the right one."""
        end_s = np.inf if self.named_s is None else self.task.fault_s + self.named_s
        right = self.task.right
        return [
            (time_s, key)
            for time_s, key in self.alarms
            if time_s <= end_s and (key not in right or time_s <= self.task.fault_s)
        ]

    def inputs(self, now_s: float) -> tuple[float, float]:
        """Return what heater and fan really do in the step that begins now."""
        duty, fan = self.sent.heater_duty, self.sent.fan
        if now_s < self.task.fault_s:
            return duty, fan
        duty = {"heater_stuck_on": 1.0, "heater_dead": 0.0}.get(self.task.fault, duty)
        return duty, {"fan_stuck_on": 1.0, "fan_stuck_off": 0.0}.get(self.task.fault, fan)

    def tick(self, now_s: float, air_c: Sequence[float], room_c: Sequence[float] | None) -> None:
        """Read the samples of the step that has passed, decide, and let safety have its say."""
        self.hottest_c = max(self.hottest_c, air_c[-1])
        samples = self._samples(now_s, self._show(now_s, air_c), room_c)
        readings = self._health.readings(samples, now_s, self.sent)
        air = readings["temp_air"]
        is_good = air.quality is ReadingQuality.GOOD and air.value is not None
        if self._was_good and not is_good:
            self.alarms.append((now_s, NOT_GOOD))
        self._was_good = is_good
        reference_c = self.task.reference_c(now_s)
        wanted = Command()
        if is_good and air.value is not None:
            self.off_by_k.append(air.value - reference_c)
            if now_s < self.task.off_s:
                wanted = self._decide(now_s, air.value, reference_c)
        verdict = supervise(wanted, self._view(now_s, readings), self._memory, self.settings.safety)
        self._memory, self.sent = verdict.memory, verdict.sent
        self.alarms += [(now_s, event.key) for event in verdict.events]

    def _show(self, now_s: float, air_c: Sequence[float]) -> Sequence[float]:
        if now_s <= self.task.fault_s:
            return air_c
        if self.task.fault == "sensor_stuck":
            self._stuck_c = air_c[0] if np.isnan(self._stuck_c) else self._stuck_c
            return [self._stuck_c] * len(air_c)
        return [value + self.task.offset_k for value in air_c]

    def _samples(
        self, now_s: float, air_c: Sequence[float], room_c: Sequence[float] | None
    ) -> list[dict[str, Reading]]:
        def reading(name: str, values: Sequence[float], k: int) -> Reading:
            time_s = now_s - SAMPLE_S * (SAMPLES - 1 - k)
            return Reading(name, float(values[k]), time_s, ReadingQuality.GOOD)

        shown = {"temp_air": air_c} | ({} if room_c is None else {"temp_ambient": room_c})
        return [{name: reading(name, values, k) for name, values in shown.items()} for k in range(SAMPLES)]

    def _decide(self, now_s: float, air_c: float, reference_c: float) -> Command:
        context = Context(
            now_s=now_s,
            utc=now_s,
            step_s=STEP_S,
            history={},
            estimate=Estimate(air_c, 0.1, 0.0, None, np.nan, now_s),
            reference=np.array([reference_c]),
            last_sent=self.sent,
            limits=planning_limits(self._memory, self.settings.safety, now_s, STEP_S, self.bounds),
        )
        wanted = self.controller.decide(context).command
        return replace(wanted, fan_on=False) if self.bounds.fan_role == "none" else wanted

    def _view(self, now_s: float, readings: dict[str, Reading]) -> SafetyView:
        sent = self.sent
        return SafetyView(
            readings=readings,
            estimate=Estimate(np.nan, np.nan, 0.0, None, np.nan, now_s),
            echo=Echo(sent.heater_duty, sent.fan_on, 0.0, False, False, "", now_s, sent.fan_share),
            link_up=True,
            emergency_stop=False,
            maintenance=False,
            now_s=now_s,
            utc=now_s,
            dt_s=STEP_S,
            box=self.bounds,
        )


def fly(body: Body, pilots: Sequence[Pilot], until_s: float) -> None:
    """Let pilots fly over the columns of a body until a time [s], or until each has named its fault."""
    for tick in range(round(until_s / STEP_S)):
        inputs = np.array([pilot.inputs(tick * STEP_S) for pilot in pilots])
        samples = body.pass_step(inputs[:, 0], inputs[:, 1])
        room_c = None if samples.room is None else samples.room.tolist()
        for pilot, air_c in zip(pilots, samples.air.T.tolist(), strict=True):
            pilot.tick((tick + 1) * STEP_S, air_c, room_c)
        if all(pilot.named_s is not None for pilot in pilots):
            break
