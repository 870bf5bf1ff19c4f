"""The rules of the safety supervisor, one small function each; supervisor.py applies them in order.

A condition returns why it forces an output, "" when it does not. Comparisons are written so that NaN forces.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from edge.config.settings import SafetySettings
from edge.core.messages import ReadingQuality
from edge.core.names import HEATER_LEVELS
from edge.safety.box_bounds import BoxBounds
from edge.safety.memory import DAY_S, HOUR_S, RISE_MARGIN, AirRise, SafetyMemory, SafetyView, heat_wh, water_s
from edge.safety.thermal_supervision import FAN_NO_EFFECT, HEATER_STUCK_ON

OVER_TEMPERATURE = "over_temperature"
HOT_TRIPS = frozenset({OVER_TEMPERATURE, HEATER_STUCK_ON})  # answered with the fan
CUTOFF_TRIPS = HOT_TRIPS | {FAN_NO_EFFECT}  # air that a fan does not cool may have a heater that is stuck on
CLOCK_SLACK_S = 0.5  # a tick may begin this much early without breaking a relay time
LED_LEVELS = 100
VALVE_STEPS_PER_S = 10
HELD_OVER_S = 1800.0  # the mean of a controller that heats in turns is what holds the air
DOUBT_S = 600.0  # then a box that is really cold has had time to show it by its other sensors
NO_RISE = AirRise()
ROUNDING = 1e-9  # 0.3 is 5.999999999999999 levels of 1/20


@dataclass(frozen=True, slots=True)
class RuleInput:
    """The input of every rule."""

    view: SafetyView
    memory: SafetyMemory
    settings: SafetySettings
    temp_air: float | None  # [°C]; None unless the reading is good and fresh


@dataclass(frozen=True, slots=True)
class ForcedOutput:
    """An output takes `value` while `condition` gives a reason."""

    key: str
    condition: Callable[[RuleInput], str]
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Limit:
    """An output stays at or below what `largest` gives, and above it for this reason."""

    key: str
    largest: Callable[[RuleInput], float]
    reason: str


def known_value(view: SafetyView, signal: str, age_max_s: float) -> float | None:
    """Return a measurement that is good, a number, at most `age_max_s` old, not of the future; else None."""
    reading = view.readings.get(signal)
    if reading is None or reading.quality is not ReadingQuality.GOOD or reading.value is None:
        return None
    fresh = -CLOCK_SLACK_S <= view.now_s - reading.time_s <= age_max_s
    return reading.value if fresh and math.isfinite(reading.value) else None


def emergency_stop(s: RuleInput) -> str:
    """Force an output while the operator's emergency stop stands; only a release ends the stop."""
    return "emergency stop" if s.view.emergency_stop else ""


def maintenance(s: RuleInput) -> str:
    """Force an output during maintenance, because a person may reach into the greenhouse."""
    return "maintenance: hands may be in the box" if s.view.maintenance else ""


def link_down(s: RuleInput) -> str:
    """Force an output without a link: no command arrives, and the board's leases run out."""
    reason = "another board is at the port" if s.view.is_foreign else "no link to the board"
    return "" if s.view.link_up else reason


def trip(s: RuleInput) -> str:
    """Force an output while any trip is latched; the reason names all of them, oldest first."""
    return f"latched: {', '.join(s.memory.trips)}" if s.memory.trips else ""


def tripped_hot(s: RuleInput) -> str:
    """Force an output while one of `HOT_TRIPS` is latched; the reason names all trips."""
    return f"latched: {', '.join(s.memory.trips)}" if HOT_TRIPS.intersection(s.memory.trips) else ""


def board_trip(s: RuleInput) -> str:
    """Force an output while the board reports a trip or a stop; a missing echo does not force."""
    echo = s.view.echo
    return f"the board has tripped: {echo.trip_cause}" if echo is not None and echo.tripped else ""


def board_stop(s: RuleInput) -> str:
    """Force an output while the board reports a stop, for which hands may be in the greenhouse."""
    echo = s.view.echo
    return f"stopped on the board: {echo.trip_cause}" if echo is not None and echo.stopped else ""


def air_unknown(s: RuleInput) -> str:
    """Force an output without a good, fresh and finite air temperature."""
    return "no fresh good air temperature" if s.temp_air is None else ""


def too_hot(s: RuleInput) -> str:
    """Force an output at or above `temp_air_max_c`, and for NaN; None is left to `air_unknown`."""
    limit = s.settings.temp_air_max_c
    if s.temp_air is None or s.temp_air < limit:
        return ""
    return f"air {s.temp_air:.1f} °C, limit {limit:g} °C"


def heater_unknown(s: RuleInput) -> str:
    """Force an output while the heater's power is not known: then no bound on its heat means anything."""
    return "" if s.view.box.heater_w > 0.0 else "the heater's power is not known: set box.heater_w"


def relay_proof(s: RuleInput) -> str:
    """Force an output while heater and fan rest for the proof, so that stray heat shows in the air."""
    return "proof that the heater's relay opens" if s.memory.thermal.proof.running else ""


def tank_low(s: RuleInput) -> str:
    """Force an output below `tank_level_min` [0..1]; a missing, old or bad level forces too."""
    level = known_value(s.view, "tank_level", s.settings.reading_age_max_s)
    if level is not None and level >= s.settings.tank_level_min:
        return ""
    return "tank level unknown" if level is None else f"tank level {level:.2f}"


def soil_wet(s: RuleInput) -> str:
    """Force an output at or above `soil_moisture_max` [0..1]; a missing, old or bad reading forces too."""
    moisture = known_value(s.view, "soil_moisture", s.settings.reading_age_max_s)
    if moisture is not None and moisture < s.settings.soil_moisture_max:
        return ""
    return "soil moisture unknown" if moisture is None else f"soil moisture {moisture:.2f}"


def relay_hold_s(memory: SafetyMemory, settings: SafetySettings, now_s: float) -> float:
    """How long the fan's relay must still keep its state, 0 when it is free [s]."""
    if memory.fan_since_s is None:
        return 0.0
    hold_s = settings.fan_min_on_s if memory.sent.fan_at_end else settings.fan_min_off_s
    return max(0.0, hold_s - CLOCK_SLACK_S - (now_s - memory.fan_since_s))


def held_on(s: RuleInput) -> str:
    """Force the fan on until its relay has been closed for `fan_min_on_s`."""
    held = s.memory.sent.fan_at_end and relay_hold_s(s.memory, s.settings, s.view.now_s) > 0.0
    return "relay minimum on time" if held else ""


def held_off(s: RuleInput) -> str:
    """Force the fan off until its relay has been open for `fan_min_off_s`; free until first switched."""
    held = not s.memory.sent.fan_at_end and relay_hold_s(s.memory, s.settings, s.view.now_s) > 0.0
    return "relay minimum off time" if held else ""


def fan_starts_left(memory: SafetyMemory, settings: SafetySettings, now_s: float) -> int:
    """How often the fan may still be started within the hour. A start counts two switches: an end is free."""
    switches = sum(now_s - at < HOUR_S for at in memory.fan_switches) + memory.sent.fan_at_end
    return max(0, (settings.fan_switches_hour_max - switches) // 2)


def often_switched(s: RuleInput) -> str:
    """Force the fan off after too many switches of its relay within an hour; one that is on may stay on."""
    if s.memory.sent.fan_at_end or fan_starts_left(s.memory, s.settings, s.view.now_s) > 0:
        return ""
    return f"{s.settings.fan_switches_hour_max} switches of the relay in an hour"


def energy_duty(
    memory: SafetyMemory,
    settings: SafetySettings,
    now_s: float,
    dt_s: float,
    window_s: float,
    heater_w: float,
) -> float:
    """Heater duty that keeps the heat of one window below its cap through the next `dt_s`, 0..1."""
    cap_wh = settings.energy_hour_max_wh if window_s == HOUR_S else settings.energy_day_max_wh
    if cap_wh >= heater_w * window_s / HOUR_S:
        return 1.0  # no more than the heater can give
    left_wh = cap_wh - heat_wh(memory, now_s, window_s)
    full_wh = heater_w * dt_s / HOUR_S
    return min(1.0, max(0.0, left_wh / full_wh)) if full_wh > 0.0 else 0.0


def duty_below_trip(
    temp_air: float | None,
    trip_c: float,
    dt_s: float,
    box: BoxBounds,
    held_duty: float,
    rise: AirRise = NO_RISE,
) -> float:
    """Heater duty that keeps a light box below the trip through the next `dt_s`, 0..1.

    Two bounds: the heat that the box can store, where known, and the fastest rise of its air, where
    one was measured. Heat in the element lets the air rise on at its present rate for the element's lag.

    held_duty : mean of the last minutes; only heat beyond it warms the air further. Of a box that is not
        known it says nothing while the air still rises; there what held the air is measured too
    """
    if temp_air is None:  # `air_unknown` forces
        return 1.0
    coasts_k = max(rise.rate_k_s, 0.0) * box.element_lag_s
    left_k = max(0.0, trip_c - max(temp_air, rise.highest_c))
    if not (coasts_k <= 0.0 or coasts_k < left_k):  # NaN lands here too
        return 0.0
    least_j_k, seen_k = box.capacity_min_j_k, RISE_MARGIN * rise.fastest_k_s * dt_s
    full_k = box.power_max_w * dt_s / least_j_k if least_j_k > 0.0 else 0.0
    stored = held_duty + (left_k - coasts_k) / full_k if full_k > 0.0 else math.inf
    seen = rise.holds + (left_k - coasts_k) / seen_k if seen_k > 0.0 else math.inf
    return min(1.0, stored, seen)


def doubted_duty(s: RuleInput) -> float:
    """Heater duty while a fall of the air is contradicted: what held the air, and nothing after DOUBT_S."""
    if s.view.air_doubt is None:
        return math.inf
    held = heat_wh(s.memory, s.view.now_s, HELD_OVER_S) / (s.view.box.heater_w * HELD_OVER_S / HOUR_S)
    return held if 0.0 <= s.view.now_s - s.view.air_doubt.since_s < DOUBT_S else 0.0


def ramp_duty(s: RuleInput) -> float:
    """Heater duty that the slew limit allows now."""
    last_s = s.memory.time_s
    passed_s = s.view.dt_s if last_s is None else max(0.0, s.view.now_s - last_s)
    return s.memory.heater_ramp + s.settings.heater_rise_per_s * passed_s


HEATER_OFF = (
    ForcedOutput("heater.emergency_stop", emergency_stop),
    ForcedOutput("heater.maintenance", maintenance),
    ForcedOutput("heater.link_down", link_down),
    ForcedOutput("heater.unknown_power", heater_unknown),
    ForcedOutput("heater.tripped", trip),
    ForcedOutput("heater.board_tripped", board_trip),
    ForcedOutput("heater.air_unknown", air_unknown),
    ForcedOutput("heater.over_temperature", too_hot),
    ForcedOutput("heater.relay_proof", relay_proof),
)
HEATER_LIMITS = (
    Limit("heater.range", lambda s: 1.0, "duty above 1"),
    Limit("heater.max_duty", lambda s: s.settings.heater_max_duty, "largest duty"),
    Limit(
        "heater.energy_hour",
        lambda s: energy_duty(s.memory, s.settings, s.view.now_s, s.view.dt_s, HOUR_S, s.view.box.heater_w),
        "energy cap of the hour",
    ),
    Limit(
        "heater.energy_day",
        lambda s: energy_duty(s.memory, s.settings, s.view.now_s, s.view.dt_s, DAY_S, s.view.box.heater_w),
        "energy cap of the day",
    ),
    Limit(
        "heater.below_trip",
        lambda s: duty_below_trip(
            s.temp_air,
            s.settings.temp_trip_c,
            s.view.dt_s,
            s.view.box,
            s.memory.thermal.heat,
            s.memory.rise,
        ),
        "more would bring the air to the trip",
    ),
    Limit("heater.air_doubted", doubted_duty, "the air fell faster than any air cools"),
    Limit("heater.slew", ramp_duty, "rises too fast"),
)
FAN_FORCED = (
    ForcedOutput("fan.emergency_stop", emergency_stop),
    ForcedOutput("fan.maintenance", maintenance),
    ForcedOutput("fan.board_stopped", board_stop),
    ForcedOutput("fan.link_down", link_down),
    ForcedOutput("fan.tripped", tripped_hot, 1.0),
    ForcedOutput("fan.over_temperature", too_hot, 1.0),
    ForcedOutput("fan.min_on", held_on, 1.0),
    ForcedOutput("fan.min_off", held_off),
    ForcedOutput("fan.switches", often_switched),
    ForcedOutput("fan.relay_proof", relay_proof),
)
FAN_LIMITS = (Limit("fan.range", lambda s: 1.0, "more than the whole step"),)
LED_OFF = (
    ForcedOutput("led.emergency_stop", emergency_stop),
    ForcedOutput("led.maintenance", maintenance),
    ForcedOutput("led.board_stopped", board_stop),
    ForcedOutput("led.link_down", link_down),
    ForcedOutput("led.tripped", tripped_hot),
    ForcedOutput("led.over_temperature", too_hot),
)
LED_LIMITS = (Limit("led.range", lambda s: s.settings.led_max, "largest LED level"),)
VALVE_SHUT = (
    ForcedOutput("valve.emergency_stop", emergency_stop),
    ForcedOutput("valve.maintenance", maintenance),
    ForcedOutput("valve.board_stopped", board_stop),
    ForcedOutput("valve.link_down", link_down),
    ForcedOutput("valve.tank", tank_low),
    ForcedOutput("valve.soil", soil_wet),
)
VALVE_LIMITS = (
    Limit("valve.pulse_max", lambda s: s.settings.valve_pulse_max_s, "longest pulse"),
    Limit(
        "valve.day_max",
        lambda s: max(0.0, s.settings.valve_day_max_s - water_s(s.memory, s.view.now_s, s.view.utc)),
        "dose of the day",
    ),
)
STEPS = {"heater_duty": HEATER_LEVELS, "led": LED_LEVELS, "valve_pulse": VALVE_STEPS_PER_S}
