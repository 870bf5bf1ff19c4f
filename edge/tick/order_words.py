"""Sentences about standing orders: what one of them changed, or what holds already."""

from collections.abc import Callable

from edge.core.plain_text import plain
from edge.tick.calibration import amount
from edge.tick.orders import FanMode, Mode, Operation
from edge.tick.standing_profile import NAME_MAX, duration

Words = Callable[[Operation, Operation, float], str]


def order_words(kind: str, before: Operation, after: Operation, utc: float) -> tuple[bool, str]:
    """Return whether an order of this kind changed anything, and what holds at `utc` since then."""
    before, after = before.at(utc), after.at(utc)
    found = [
        words
        for words, names in _TOPICS.items()
        if any(getattr(before, name) != getattr(after, name) for name in names)
    ]
    topics = found or [_TOPIC_OF.get(kind, _set_point)]
    if _set_point in topics and _mode not in topics and after.mode not in (Mode.AUTO, Mode.HEAT):
        topics.append(_mode)
    text = " ".join(filter(None, (words(before, after, utc) for words in (*topics, _still_off))))
    return before != after, text if before != after else nothing_changed(text)


def nothing_changed(text: str) -> str:
    """Return the message of an order that changed nothing, because `text` holds already."""
    return f"Nothing changed: {text[0].lower()}{text[1:]}"


def _still_off(before: Operation, after: Operation, utc: float) -> str:
    """Return what holds everything off as it did before the order."""
    said, until = [], after.maintenance_until_utc
    if before.emergency_stop and after.emergency_stop:
        said.append("The emergency stop holds everything off until it is released.")
    if until is not None and until == before.maintenance_until_utc:
        said.append(
            f"Maintenance holds everything off for another {duration(until - utc)}; "
            "`greenhouse maintenance 0` ends it."
        )
    return " ".join(said)


def _stop(before: Operation, after: Operation, utc: float) -> str:
    if after.emergency_stop:
        return "" if before.emergency_stop else "Emergency stop: everything is off until it is released."
    return "The emergency stop is released." if before.emergency_stop else "There is no emergency stop."


def _maintenance(before: Operation, after: Operation, utc: float) -> str:
    until = after.maintenance_until_utc
    if until is None:
        return "There is no maintenance." if before.maintenance_until_utc is None else "Maintenance is over."
    is_same = until == before.maintenance_until_utc
    return "" if is_same else f"Maintenance: everything is off for {duration(until - utc)}."


def _mode(before: Operation, after: Operation, utc: float) -> str:
    """Return who decides on heater and fan, as `edge.tick.orders.apply_orders` has it."""
    mode, manual, name = after.mode, after.manual, after.controller
    if mode is Mode.MANUAL:
        duty, fan = f"{manual.heater_duty:.2f}", "on" if manual.fan_on else "off"
        return f"In mode manual, the heater is at {duty}, the fan is {fan} and the light at {manual.led:.2f}."
    if mode is Mode.OFF:
        return f"In mode off, heater and fan stay off, and the controller {name} waits."
    fan = "off" if mode is Mode.HEAT and after.fan_mode is FanMode.AUTO else after.fan_mode.value
    stay = ["the heater stays off"] * (mode is Mode.FAN_ONLY) + [f"the fan stays {fan}"] * (fan != "auto")
    own = ["the heater"] * (mode is not Mode.FAN_ONLY) + ["the fan"] * (fan == "auto")
    controls = [f"{name} controls {' and '.join(own)}"] if own else []
    return f"In mode {mode.value}, {', and '.join(controls + stay)}."


def _set_point(before: Operation, after: Operation, utc: float) -> str:
    profile, by_hand_c, steering = after.profile, after.reference_c, after.steering
    is_off = after.emergency_stop or after.maintenance_until_utc is not None
    holds = not is_off and after.mode in (Mode.AUTO, Mode.HEAT)
    said = ["What was confirmed in words is undone."] if before.steering and not steering else []
    if steering is not None and (by_hand_c is None or steering != before.steering):
        said = [f"As confirmed in words: {steering.words}."]
    if by_hand_c is None and not (steering and steering.daily):
        verb, source = "Holding", "the configured set point"
        if profile is not None:
            verb, source = "Following", f"the profile {profile.in_words()}"
        return " ".join([f"{verb if holds else 'Set to'} {source}.", *said])
    if by_hand_c is not None:
        degrees = max(f"{by_hand_c:.1f}", f"{by_hand_c:g}", key=len)
        said.insert(0, f"{'Holding' if holds else 'Set to'} {degrees} °C by hand.")
    if profile is not None:
        state = "is paused" if profile.is_paused else "runs on meanwhile"
        said.append(f'The profile "{plain(profile.name, NAME_MAX)}" {state}.')
    return " ".join(said)


def _calibration(before: Operation, after: Operation, utc: float) -> str:
    for point in set(after.points) - set(before.points):
        true, raw = (amount(point.signal, value) for value in (point.true_value, point.raw))
        return f"A point of {point.signal} was taken: {true} is true, the raw readings are {raw} on average."
    for each in set(after.calibrations) - set(before.calibrations):
        return f"{each.signal} is calibrated by its points."
    for each in set(before.calibrations) - set(after.calibrations):
        return f"{each.signal} is calibrated as configured."
    signals = {each.signal for each in before.points} - {each.signal for each in after.points}
    return " ".join(f"The points of {signal} are discarded." for signal in signals)


_TOPICS: dict[Words, tuple[str, ...]] = {
    _stop: ("emergency_stop",),
    _maintenance: ("maintenance_until_utc",),
    _mode: ("mode", "manual", "fan_mode", "controller"),
    _set_point: ("reference_c", "profile", "steering"),
    _calibration: ("points", "calibrations"),
}
_TOPIC_OF = {  # kind of an order -> what it is about; the others are about the set point
    "emergency_stop": _stop,
    "release_emergency_stop": _stop,
    "maintenance": _maintenance,
    **dict.fromkeys(("set_mode", "set_fan_mode", "set_controller", "set_manual"), _mode),
}
