"""edge/tick/orders.py: what an operator ordered, in words that a person would use."""

from typing import Any

import pytest

from edge.tick.orders import ORDERS, in_words

SAID = {
    "the mode was set to heat": {"do": "set_mode", "mode": "heat"},
    "the fan was set to on": {"do": "set_fan_mode", "fan_mode": "on"},
    "the reference was set to 26 °C": {"do": "set_reference", "reference_c": 26.0},
    "the reference follows the configuration again": {"do": "set_reference", "reference_c": None},
    "the controller was set to PID": {"do": "set_controller", "name": "PID"},
    "the controller follows the configuration again": {"do": "set_controller", "name": None},
    "manual: heater 0.50, fan on, until the mode changes": {
        "do": "set_manual",
        "heater_duty": 0.5,
        "fan_on": 1,
    },
    "emergency stop: everything is off until it is released": {"do": "emergency_stop"},
    "the emergency stop was released": {"do": "release_emergency_stop"},
    "maintenance: everything is off for 30 minutes": {"do": "maintenance", "minutes": 30.0},
    "maintenance: everything is off for 1 minute": {"do": "maintenance", "minutes": 1.0},
    "maintenance was ended": {"do": "maintenance", "minutes": 0.0},
    "confirmed: 20 at night": {"do": "steer", "steering": {"words": "20 at night"}},
    "what was confirmed last was undone": {"do": "undo"},
}


@pytest.mark.parametrize(("text", "request_"), SAID.items())
def test_an_order_reads_as_a_sentence(text: str, request_: dict[str, Any]) -> None:
    assert in_words(request_) == text


def test_every_order_has_its_words() -> None:
    assert {request["do"] for request in SAID.values()} == set(ORDERS)
