"""An operator's order as the sentence that its event says."""

from collections.abc import Callable, Mapping
from typing import Any

Request = Mapping[str, Any]


def in_words(request: Request) -> str:
    """Describe an order that was carried out: `request` has passed `edge.tick.orders.operate`."""
    return _WORDS[request["do"]](request)


def _reference(request: Request) -> str:
    value = request.get("reference_c")
    return _FOLLOWS.format("reference") if value is None else f"the reference was set to {value:g} °C"


def _controller(request: Request) -> str:
    name = request["name"]
    return _FOLLOWS.format("controller") if name is None else f"the controller was set to {name}"


def _manual(request: Request) -> str:
    named = []
    if "heater_duty" in request:
        named.append(f"heater {request['heater_duty']:.2f}")
    if "fan_on" in request:
        named.append(f"fan {'on' if request['fan_on'] else 'off'}")
    if "led" in request:
        named.append(f"LED {request['led']:.2f}")
    return f"manual: {', '.join(named) or 'the last manual command'}, until the mode changes"


def _maintenance(request: Request) -> str:
    minutes = request["minutes"]
    if minutes == 0:
        return "maintenance was ended"
    length = "1 minute" if minutes == 1 else f"{minutes:g} minutes"
    return f"maintenance: everything is off for {length}"


_FOLLOWS = "the {} follows the configuration again"
_WORDS: dict[str, Callable[[Request], str]] = {
    "set_mode": lambda request: f"the mode was set to {request['mode']}",
    "set_fan_mode": lambda request: f"the fan was set to {request['fan_mode']}",
    "set_reference": _reference,
    "set_controller": _controller,
    "set_manual": _manual,
    "emergency_stop": lambda _: "emergency stop: everything is off until it is released",
    "release_emergency_stop": lambda _: "the emergency stop was released",
    "maintenance": _maintenance,
    "steer": lambda request: f"confirmed: {request['steering']['words']}",
    "undo": lambda _: "what was confirmed last was undone",
}
