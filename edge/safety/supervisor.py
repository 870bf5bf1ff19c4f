"""The safety supervisor: pure, and the last before the board for every writer.

Whatever a controller, a model, MQTT or a person wants: what `supervise` returns is a legal command, and every
difference carries a rule's key and a reason. Limits that YAML cannot widen stand in edge/core/hard_limits.py.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

from edge.config.settings import SafetySettings
from edge.core.controller import ControlLimits
from edge.core.errors import RequestError
from edge.core.hard_limits import FAN_PART_S
from edge.core.messages import Change, Command, Event, Severity
from edge.safety.box_bounds import PAPER_BOX, BoxBounds
from edge.safety.memory import (
    DAY_S,
    HOUR_S,
    SafetyMemory,
    SafetyVerdict,
    SafetyView,
    book_heat,
    follow_air,
    remember,
)
from edge.safety.rules import (
    CUTOFF_TRIPS,
    FAN_FORCED,
    FAN_LIMITS,
    HEATER_LIMITS,
    HEATER_OFF,
    LED_LIMITS,
    LED_OFF,
    OVER_TEMPERATURE,
    ROUNDING,
    STEPS,
    VALVE_LIMITS,
    VALVE_SHUT,
    ForcedOutput,
    Limit,
    RuleInput,
    energy_duty,
    fan_starts_left,
    known_value,
    relay_hold_s,
)
from edge.safety.thermal_supervision import (
    FAN_NO_EFFECT,
    GAP_MAX_S,
    GAP_MAX_STEPS,
    Observation,
    PartFault,
    ThermalMemory,
    look,
    shift_readings,
)

__all__ = [
    "SafetyMemory",
    "SafetyVerdict",
    "SafetyView",
    "clear_trip",
    "follow_calibration",
    "planning_limits",
    "supervise",
]

CLEAR_BELOW_K = 3.0  # a trip is cleared only when the air is this far below the trip, as on the board


def supervise(
    wanted: Command, view: SafetyView, memory: SafetyMemory, settings: SafetySettings
) -> SafetyVerdict:
    """Return the part of `wanted` that may be sent now, why it differs, and the new memory."""
    temp_air = known_value(view, "temp_air", settings.reading_age_max_s)
    memory = book_heat(memory, view.now_s, view.dt_s, view.box.heater_w)
    # Hands are inside during maintenance: an open box gives no evidence about its heater.
    seen_c = None if view.maintenance else temp_air
    memory = replace(
        memory, rise=follow_air(memory.rise, view.now_s, view.dt_s, seen_c, memory.sent.heater_duty)
    )
    # Trips first: the limits below act on a trip of this very tick.
    memory, events = _latch(view, memory, settings, temp_air)
    situation = RuleInput(view, memory, settings, temp_air)
    changes: list[Change] = []
    ramp = _limit("heater_duty", wanted.heater_duty, HEATER_OFF, HEATER_LIMITS, situation, changes)
    fan = _limit("fan_on", _fan_asked(wanted), FAN_FORCED, FAN_LIMITS, situation, changes)
    led = _limit("led", wanted.led, LED_OFF, LED_LIMITS, situation, changes)
    pulse = _limit("valve_pulse", wanted.valve_pulse_s, VALVE_SHUT, VALVE_LIMITS, situation, changes)
    share = _fan_part(fan, view.dt_s, settings, changes)
    sent = Command(
        heater_duty=_step("heater_duty", ramp, changes),
        fan_on=share > 0.0,
        fan_share=share or 1.0,
        led=_step("led", led, changes),
        valve_pulse_s=_step("valve_pulse", pulse, changes),
    )
    return SafetyVerdict(
        sent=sent,
        changes=tuple(changes),
        memory=remember(memory, sent, ramp, view),
        events=events,
        open_cutoff=view.emergency_stop or view.maintenance or not CUTOFF_TRIPS.isdisjoint(memory.trips),
    )


def follow_calibration(memory: SafetyMemory, air_k: float, room_k: float) -> SafetyMemory:
    """Return the memory where calibrations lift the readings of air and room from now on [K]."""
    seen = memory.rise
    rise = replace(seen, air_c=seen.air_c + air_k, highest_c=seen.highest_c + air_k)
    return replace(memory, thermal=shift_readings(memory.thermal, air_k, room_k), rise=rise)


def planning_limits(
    memory: SafetyMemory,
    settings: SafetySettings,
    now_s: float,
    step_s: float,
    box: BoxBounds = PAPER_BOX,
) -> ControlLimits:
    """Return the safety limits of the step that begins now, for a controller that plans."""
    rests = memory.trips or memory.thermal.proof.running or not box.heater_w > 0.0
    duty = 0.0 if rests else settings.heater_max_duty
    for window_s in (HOUR_S, DAY_S):
        duty = min(duty, energy_duty(memory, settings, now_s, step_s, window_s, box.heater_w))
    proof_s = memory.thermal.proof.due_in_s
    return ControlLimits(
        heater_max_duty=duty,
        fan_hold_steps=math.ceil(relay_hold_s(memory, settings, now_s) / step_s),
        fan_min_on_steps=max(1, math.ceil(settings.fan_min_on_s / step_s)),
        fan_min_off_steps=max(1, math.ceil(settings.fan_min_off_s / step_s)),
        temp_air_max_c=settings.temp_air_max_c,
        fan_part_s=max(FAN_PART_S, settings.fan_min_on_s),
        fan_starts=fan_starts_left(memory, settings, now_s),
        heater_w=box.heater_w,
        fan_role=box.fan_role,
        proof_in_steps=math.ceil(proof_s / step_s) if math.isfinite(proof_s) else None,
    )


def clear_trip(memory: SafetyMemory, settings: SafetySettings, temp_air: float | None) -> SafetyMemory:
    """Return the memory without its trips. Errors: RequestError while the cause may still be there

    temp_air : [°C]; None unless good
    """
    if not memory.trips:
        return memory
    limit = min(settings.temp_air_max_c, settings.temp_trip_c - CLEAR_BELOW_K)
    if temp_air is None or not temp_air < limit:
        air = "unknown" if temp_air is None else f"{temp_air:.1f} °C"
        raise RequestError(f"clear_trip: the air is {air}; it must be below {limit:g} °C")
    return replace(memory, trips=(), thermal=ThermalMemory())


def _latch(
    view: SafetyView, memory: SafetyMemory, settings: SafetySettings, temp_air: float | None
) -> tuple[SafetyMemory, tuple[Event, ...]]:
    """Trips that begin now."""
    memory, findings = _look(view, memory, temp_air)
    if temp_air is not None and not temp_air < settings.temp_trip_c:
        text = (
            f"air {temp_air:.1f} °C, trip at {settings.temp_trip_c:g} °C: look at heater, fan and lid, "
            "let the air cool, then clear the trip (`greenhouse clear-trip`)"
        )
        findings = (PartFault(OVER_TEMPERATURE, text), *findings)
    new = tuple(finding for finding in findings if finding.trip not in memory.trips)
    events = tuple(
        Event(f"safety.{f.trip}", Severity.ALARM, f"{f.text}; no heat until reset", view.now_s, view.utc)
        for f in new
    )
    return replace(memory, trips=memory.trips + tuple(finding.trip for finding in new)), events


def _look(
    view: SafetyView, memory: SafetyMemory, temp_air: float | None
) -> tuple[SafetyMemory, tuple[PartFault, ...]]:
    """Thermal supervision of the time since the last decision; anew where something is not known."""
    echo, last_s = view.echo, memory.time_s
    # A gap, or a restart, does not put off the next proof of the relay.
    proof = replace(memory.thermal.proof, running_s=None, highest_c=-math.inf)
    anew = replace(memory, thermal=ThermalMemory(proof=proof))
    # Hands are inside: a sensor that is held into warm water is no heat of a stuck relay. All is off anyway.
    if temp_air is None or echo is None or last_s is None or not view.link_up or view.maintenance:
        return anew, ()
    passed_s = view.now_s - last_s
    if not 0.0 <= passed_s <= max(GAP_MAX_S, GAP_MAX_STEPS * view.dt_s):
        return anew, ()
    moment = Observation(
        dt_s=passed_s,
        temp_air=temp_air,
        temp_ambient=known_value(view, "temp_ambient", GAP_MAX_S),
        heater_duty=echo.heater_duty,
        fan_on=echo.fan_on or memory.sent.fan_on,
        fan_share=memory.sent.fan_share if memory.sent.fan_on else 1.0,
        led=echo.led,
        fan_trusted=FAN_NO_EFFECT not in memory.trips,
    )
    thermal, findings = look(memory.thermal, moment, view.box)
    return replace(memory, thermal=thermal), findings


def _limit(
    actuator: str,
    wanted: float,
    forced: Iterable[ForcedOutput],
    limits: Iterable[Limit],
    situation: RuleInput,
    changes: list[Change],
) -> float:
    """`wanted` after the first rule that forces it, or after all that limit it."""
    value = _check(actuator, wanted, changes)
    for rule in forced:
        reason = rule.condition(situation)
        if reason:
            _note(rule.key, actuator, value, rule.value, reason, changes)
            return rule.value
    for limit in limits:
        largest = limit.largest(situation)
        if not value <= largest:
            _note(limit.key, actuator, value, largest, limit.reason, changes)
            value = largest
    return value


def _check(actuator: str, wanted: float, changes: list[Change]) -> float:
    """Return a number from 0 up; any other value becomes 0."""
    try:
        value = float(wanted)
    except (TypeError, ValueError):
        value = math.nan
    if 0.0 <= value < math.inf:
        return value
    key = f"{actuator.partition('_')[0]}.not_a_number"
    changes.append(Change(key, actuator, value, 0.0, "not a number from 0 up"))
    return 0.0


def _step(actuator: str, value: float, changes: list[Change]) -> float:
    """`value` cut down to a step the wire can carry."""
    steps = STEPS[actuator]
    stepped = math.floor(value * steps + ROUNDING) / steps
    _note(f"{actuator.partition('_')[0]}.step", actuator, value, stepped, f"steps of 1/{steps}", changes)
    return stepped


def _fan_asked(wanted: Command) -> float:
    """Return the share asked for; what is neither on nor off as it is, for the rules to judge."""
    on: float = wanted.fan_on
    return wanted.fan if on == 1.0 else on


def _fan_part(share: float, dt_s: float, settings: SafetySettings, changes: list[Change]) -> float:
    """`share` of the step cut down to whole `FAN_PART_S`; 0 where that is too short for the relay."""
    if share >= 1.0:
        return 1.0
    part_s = math.floor(share * dt_s / FAN_PART_S + ROUNDING) * FAN_PART_S
    part = part_s / dt_s if part_s >= settings.fan_min_on_s else 0.0
    _note("fan.step", "fan_on", share, part, f"steps of {FAN_PART_S:g} s, the relay's shortest", changes)
    return part


def _note(key: str, actuator: str, wanted: float, sent: float, reason: str, changes: list[Change]) -> None:
    if abs(wanted - sent) > ROUNDING:
        changes.append(Change(key, actuator, wanted, sent, reason))
