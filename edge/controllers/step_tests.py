"""Step tests that find their own size: the next leg comes from what the box did in the last ones.

First a rest with the fan still and on, a little heat and a coast tell how fast the box answers and how far
it runs on by itself. After these come legs of random heat and fan inside the band, some as long as the box
needs to show its slow parts. Heat ends before the band's upper edge by what the box was seen to run on. The
same seed gives the same tests.
"""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS

REST_S = 180.0  # the sensor's noise, and the room
SETTLE_S = 300.0  # after hands were in the box
FAN_AT_REST_S = 120.0  # in a box as warm as its room, where what the fan itself warms shows alone
PROBE_DUTY, PROBE_RISE_K = 0.4, 1.0  # first heat, little enough for the smallest box
PROBE_MAX_S, COAST_MAX_S, FULL_MAX_S = 600.0, 900.0, 1500.0
PEAK_K = 0.15  # below its peak the air has stopped running on
DWELL_MIN_S, DWELL_MAX_S = 120.0, 720.0  # of a random leg
SLOW_RISE_K = 4.0  # a box that full heat warms by less in FULL_MAX_S is slow: it gets longer legs
SLOW_FULL_MAX_S, SLOW_DWELL_MAX_S = 3600.0, 1800.0
SLOW_LEG = 4  # every so many legs is SLOW_TIMES as long
SLOW_TIMES = 2.5
LOW_K = 1.5  # above the room: a colder box has nothing to tell about its losses
DUTIES = (0.0, 0.0, 0.25, 0.5, 0.75, 1.0)
PULSES_S = (10.0, 20.0, 40.0)  # of the fan, as plans use them
PULSE_EVERY_S = 120.0
PAUSE, SETTLE = "pause", "settle"  # names of legs: hands are in the box, and after they have left


@dataclass(frozen=True, slots=True)
class TestLeg:
    """A stretch of constant heat. fan : "off", "on" or "pulses"; ends at most `max_s` after its begin"""

    name: str
    duty: float
    max_s: float
    fan: str = "off"
    above_c: float = math.inf  # ends where the air is warmer
    until_peak: bool = False  # ends when the air has stopped rising
    below_c: float = -math.inf


@dataclass(frozen=True, slots=True)
class BoxResponse:
    """The box by its first legs.

    rise_k_s : at full duty, steepest; runs_on_k, runs_on_s : after heat ended
    """

    rise_k_s: float
    runs_on_k: float
    runs_on_s: float


class StepTests:
    """A controller that drives the tests.

    high_c : upper edge of the band [°C]; has_fan : the box has one that acts on the air
    """

    name = "step-tests"

    def __init__(self, high_c: float, has_fan: bool, seed: int = 1) -> None:
        self._high_c, self._has_fan, self._seed = high_c, has_fan, seed
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.response: BoxResponse | None = None
        self._random = random.Random(self._seed)
        self._legs = self._plan()
        self._leg = next(self._legs)
        self._begun_s: float | None = None
        self._begun_c = self._highest_c = self._lowest_c = math.nan
        self._steepest = 0.0
        self._is_slow = False
        self._is_paused = False
        self._is_opening = True  # legs whose answers the later ones are made from

    def pause(self) -> None:
        """Rest from the next decision on: hands are in the box."""
        self._is_paused = True

    def go_on(self) -> None:
        """Let the box settle, then repeat the leg that was interrupted.

        Heat must be seen from its begin to tell how far the box runs on, so the first legs begin anew.
        """
        if not self._is_paused:
            return
        self._is_paused = False
        if self._is_opening:
            self.reset()
        if self._leg.name != SETTLE:
            self._legs = chain([self._leg], self._legs)
        self._leg, self._begun_s = TestLeg(SETTLE, 0.0, SETTLE_S), None

    def decide(self, context: Context) -> Decision:
        """Return the command of the present leg, or of the next where this one is over."""
        air = context.estimate.temp_air
        if self._is_paused:
            return Decision(Command(), self.name, why={"leg": PAUSE, "band_c": self._high_c})
        if self._begun_s is None or self._is_over(context, air):
            if self._begun_s is not None:
                self._note(context, air)
                self._leg = next(self._legs)
            self._begun_s, self._begun_c = context.now_s, air
            self._highest_c = self._lowest_c = air
            self._highest_s = context.now_s
        self._watch(context, air)
        leg = self._leg
        duty = leg.duty if air < self._high_c - self._margin_k(leg.duty) else 0.0
        duty = math.floor(min(duty, context.limits.heater_max_duty) * HEATER_LEVELS + 1e-9) / HEATER_LEVELS
        command = Command(duty, self._fan_on(context))
        return Decision(command, self.name, why={"leg": leg.name, "band_c": self._high_c})

    def _plan(self) -> Iterator[TestLeg]:
        yield TestLeg("rest", 0.0, REST_S)
        if self._has_fan:
            yield TestLeg("fan at rest", 0.0, FAN_AT_REST_S, "on")
        yield TestLeg("first heat", PROBE_DUTY, PROBE_MAX_S, above_c=self._begun_c + PROBE_RISE_K)
        yield TestLeg("coast", 0.0, COAST_MAX_S, until_peak=True)
        yield TestLeg("full heat", 1.0, FULL_MAX_S, above_c=self._high_c)
        yield TestLeg("coast", 0.0, COAST_MAX_S / 2.0, until_peak=True)
        if self._has_fan:
            yield TestLeg("fan", 0.0, 60.0, "on")
        count, self._is_opening = 0, False
        while True:
            count += 1
            duty, dwell_s = self._random.choice(DUTIES), self._dwell_s()
            fan = "off"
            if self._has_fan:
                fan = self._random.choice(
                    ("off", "off", "off", "pulses", "pulses", "on" if duty < 1.0 else "off")
                )
            if fan == "on":
                dwell_s = min(dwell_s, 180.0)
            if count % SLOW_LEG == 0:
                fan, dwell_s = "off", SLOW_TIMES * dwell_s
            yield TestLeg(f"heat {duty:g}, fan {fan}", duty, dwell_s, fan)

    def _dwell_s(self) -> float:
        """Return a random length for a box of this speed [s]."""
        usual = 240.0 if self.response is None else max(2.0 * self.response.runs_on_s, 120.0)
        longest = SLOW_DWELL_MAX_S if self._is_slow else DWELL_MAX_S
        usual = max(usual, 0.5 * longest) if self._is_slow else usual
        return min(max(usual * self._random.uniform(0.5, 2.0), DWELL_MIN_S), longest)

    def _is_over(self, context: Context, air: float) -> bool:
        assert self._begun_s is not None
        leg, passed_s = self._leg, context.now_s - self._begun_s
        if passed_s >= self._longest_s(air) - 0.5 * context.step_s:
            return True
        if leg.name == "first heat" and air >= self._begun_c + PROBE_RISE_K:
            return True
        if leg.duty > 0.0 and air >= self._high_c - self._margin_k(leg.duty):
            return True
        if leg.until_peak:
            return air < self._highest_c - PEAK_K and passed_s > 30.0
        # A box that is nearly as cold as the room has nothing to tell without heat.
        return leg.duty == 0.0 and leg.name.startswith("heat") and air < context.estimate.temp_ambient + LOW_K

    def _longest_s(self, air: float) -> float:
        """Return how long this leg may be: full heat goes on in a box that it hardly warms."""
        is_slow = self._leg.name == "full heat" and air - self._begun_c < SLOW_RISE_K
        return SLOW_FULL_MAX_S if is_slow else self._leg.max_s

    def _watch(self, context: Context, air: float) -> None:
        if air > self._highest_c:
            self._highest_c, self._highest_s = air, context.now_s
        past = context.history["temp_air"]
        if self._leg.duty > 0.0 and len(past) > 6 and np.isfinite(past[-7]):
            rise = (air - float(past[-7])) / (6.0 * context.step_s) / self._leg.duty
            self._steepest = max(self._steepest, rise)

    def _note(self, context: Context, air: float) -> None:
        """Learn from a coast how far the box runs on, and from full heat whether it is slow."""
        assert self._begun_s is not None
        if self._leg.name == "full heat":
            self._is_slow = context.now_s - self._begun_s > FULL_MAX_S
        if self._leg.name != "coast":
            return
        runs_on = max(self._highest_c - self._begun_c, 0.0)
        duty = PROBE_DUTY if self.response is None else 1.0
        self.response = BoxResponse(self._steepest, runs_on / duty, self._highest_s - self._begun_s)

    def _margin_k(self, duty: float) -> float:
        """Return how far below the edge heat must end."""
        if self.response is None:
            return 3.0 * duty
        return 1.3 * self.response.runs_on_k * duty + 0.3

    def _fan_on(self, context: Context) -> bool:
        if self._leg.fan != "pulses" or context.limits.fan_starts < 4:
            return self._leg.fan == "on" and (context.limits.fan_starts > 0 or context.last_sent.fan_at_end)
        assert self._begun_s is not None
        passed_s = context.now_s - self._begun_s
        pulse, since = divmod(passed_s + 1e-6, PULSE_EVERY_S)
        return since < PULSES_S[int(pulse) % len(PULSES_S)] - 1e-3
