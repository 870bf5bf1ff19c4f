"""Icons of the entities, names of the Material Design set that Home Assistant carries.

A binary sensor with a device class has none of ours: Home Assistant changes its icon with its state.
"""

from collections.abc import Mapping
from typing import Any

_BY_CLASS = {
    "temperature": "thermometer",
    "humidity": "water-percent",
    "moisture": "sprout",
    "carbon_dioxide": "molecule-co2",
    "duration": "timer-outline",
}
_BY_KEY = {
    "climate": "greenhouse",
    "temp_ambient": "home-thermometer-outline",
    "ambient_rel_humidity": "home-thermometer-outline",
    "light": "white-balance-sunny",
    "tank_level": "cup-water",
    "estimate": "thermometer-lines",
    "reference": "thermometer-check",
    "heater_duty": "radiator",
    "manual_heater_duty": "radiator",
    "led": "led-strip-variant",
    "ticks_late": "timer-alert-outline",
    "ticks_skipped": "debug-step-over",
    "outbox_depth": "tray-full",
    "controller": "brain",
    "last_event": "message-alert-outline",
    "last_answer": "message-reply-text-outline",
    "stop": "alert-octagon",
    "emergency_stop": "alert-octagon",
    "release_emergency_stop": "lock-open-check",
    "clear_trip": "fire-alert",
    "follow_schedule": "calendar-clock",
    "maintenance": "hand-back-right",
    "ask": "chat-question",
    "proposal": "text-box-check-outline",
    "confirm_proposal": "check-circle",
    "discard_proposal": "close-circle",
    "undo": "undo",
    "commission": "school",
    "end_commissioning": "stop-circle-outline",
    "commissioning": "progress-clock",
}
_BY_START = {"line_": "swap-horizontal", "error_": "chart-bell-curve", "skill_": "medal-outline"}
_OTHER = "gauge"  # of a signal that somebody adds


def icon_of(key: str, component: Mapping[str, Any]) -> dict[str, str]:
    """Return the key `icon` of a component, or nothing where Home Assistant's own is better."""
    if component["platform"] == "binary_sensor" and "device_class" in component:
        return {}
    by_start = next((icon for start, icon in _BY_START.items() if key.startswith(start)), _OTHER)
    icon = _BY_KEY.get(key) or _BY_CLASS.get(component.get("device_class", ""), by_start)
    return {"icon": f"mdi:{icon}"}
