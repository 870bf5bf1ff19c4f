"""Sentences about standing orders: what one of them changed, or what holds already."""

from collections.abc import Callable
from operator import attrgetter

from edge.core.plain_text import plain
from edge.tick.calibration import amount
from edge.tick.orders import FanMode, Mode, Operation
from edge.tick.standing_profile import NAME_MAX, duration

Words = Callable[[Operation, Operation, float], str]


def order_words(kind: str, before: Operation, after: Operation, utc: float) -> tuple[bool, str]:
    """Return whether an order of this kind changed anything, and what holds at `utc` since then."""
    before, after = before.at(utc), after.at(utc)
    if kind.endswith("_profile") and before.profile is after.profile is None:
        return False, "Nothing changed: no profile is followed."
    topics = [words for words, parts in _TOPICS.items() if parts(before) != parts(after)]
    topics = topics or [_TOPIC_OF.get(kind, _set_point)]
    if _set_point in topics and _mode not in topics and after.mode not in (Mode.AUTO, Mode.HEAT):
        topics.append(_mode)
    text = " ".join(filter(None, (words(before, after, utc) for words in (*topics, _still_off))))
    changed = before != after
    return changed, text if changed else f"Nothing changed: {text[0].lower()}{text[1:]}"


def _still_off(before: Operation, after: Operation, utc: float) -> str:
    """Return what holds everything off as it did before the order."""
    said, until = [], after.maintenance_until_utc
    if before.emergency_stop and after.emergency_stop:
        said.append("The emergency stop holds everything off until it is released.")
    if until is not None and until == before.maintenance_until_utc:
        left = f"Maintenance holds everything off for another {duration(until - utc)}"
        said.append(f"{left}; `greenhouse maintenance 0` ends it.")
    return " ".join(said)


def _stop(before: Operation, after: Operation, utc: float) -> str:
    if after.emergency_stop:
        return "" if before.emergency_stop else "Emergency stop: everything is off until it is released."
    return "The emergency stop is released." if before.emergency_stop else "There is no emergency stop."


def _maintenance(before: Operation, after: Operation, utc: float) -> str:
    was, until = before.maintenance_until_utc, after.maintenance_until_utc
    if until is None:
        return "There is no maintenance." if was is None else "Maintenance is over."
    return "" if until == was else f"Maintenance: everything is off for {duration(until - utc)}."


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
    verb = "Set to" if is_off or after.mode not in (Mode.AUTO, Mode.HEAT) else "Holding"
    said = []
    if by_hand_c is not None:
        said.append(f"{verb} {max(f'{by_hand_c:.1f}', f'{by_hand_c:g}', key=len)} °C by hand.")
    elif not (steering and steering.daily):
        followed = profile and f"{verb.replace('Holding', 'Following')} the profile {profile.in_words()}."
        said.append(followed or f"{verb} the configured set point.")
        profile = None
    if steering is not None and (by_hand_c is None or steering != before.steering):
        said.append(f"As confirmed in words: {steering.words}.")
    elif steering is None and before.steering is not None:
        said.append("What was confirmed in words is undone.")
    if profile is not None:  # it is not followed now
        state = "is paused" if profile.is_paused else "runs on meanwhile"
        said.append(f'The profile "{plain(profile.name, NAME_MAX)}" {state}.')
    return " ".join(said)


def _calibration(before: Operation, after: Operation, utc: float) -> str:
    points = ", ".join(f"{each.signal} {amount(each.signal, each.true_value)}" for each in after.points)
    own = ", ".join(each.signal for each in after.calibrations)
    return f"Calibrated by hand: {own or 'no sensor'}. Points to apply: {points or 'none'}."


_TOPICS: dict[Words, Callable[[Operation], object]] = {  # with the orders that they are about
    _stop: attrgetter("emergency_stop"),
    _maintenance: attrgetter("maintenance_until_utc"),
    _mode: attrgetter("mode", "manual", "fan_mode", "controller"),
    _set_point: attrgetter("reference_c", "profile", "steering"),
    _calibration: attrgetter("points", "calibrations"),
}
_TOPIC_OF = {  # by kind of an order; the others are about the set point
    **dict.fromkeys(("emergency_stop", "release_emergency_stop"), _stop),
    **dict.fromkeys(("set_mode", "set_fan_mode", "set_controller", "set_manual"), _mode),
    "maintenance": _maintenance,
}
