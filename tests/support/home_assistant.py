"""Home Assistant's device-based discovery, checked by rules written from its own schemas.

Sources, Home Assistant core, `homeassistant/components/mqtt/`: `schemas.py` (device, origin, availability,
keys common to all entities), `config.py` (keys of read-only and read-write platforms), `climate.py`,
`sensor.py`, `binary_sensor.py`, `button.py`, `switch.py`, `number.py`, `text.py`; device classes and units:
`components/sensor/const.py`, `components/binary_sensor/__init__.py`. Home Assistant drops keys it does not
know without a word, so here an unknown key is an error.
"""

import re
from typing import Any

ID = re.compile(r"[a-zA-Z0-9_-]+")
ENTITY_ID = re.compile(r"[a-z_]+\.[a-z0-9]+(_[a-z0-9]+)*")

AVAILABILITY = {
    "availability",
    "availability_mode",
    "availability_template",
    "availability_topic",
    "payload_available",
    "payload_not_available",
}
ROOT = AVAILABILITY | {"device", "origin", "components", "state_topic", "command_topic", "qos", "encoding"}
DEVICE = {
    "identifiers",
    "connections",
    "manufacturer",
    "model",
    "model_id",
    "name",
    "hw_version",
    "serial_number",
    "sw_version",
    "via_device",
    "suggested_area",
    "configuration_url",
}
ORIGIN = {"name", "sw_version", "support_url"}
ENTITY = AVAILABILITY | {
    "platform",
    "name",
    "unique_id",
    "default_entity_id",
    "enabled_by_default",
    "entity_category",
    "entity_picture",
    "icon",
    "json_attributes_topic",
    "json_attributes_template",
    "qos",
    "encoding",
}
AVAILABILITY_ENTRY = {"topic", "payload_available", "payload_not_available", "value_template"}
READ_ONLY = {"state_topic", "value_template"}
READ_WRITE = READ_ONLY | {"command_topic", "retain"}

CLIMATE_PAIRS = ("mode", "temperature", "fan_mode", "preset_mode", "swing_mode", "target_humidity")
PLATFORMS: dict[str, set[str]] = {
    "climate": {f"{pair}_{end}" for pair in CLIMATE_PAIRS for end in ("command_topic", "command_template")}
    | {f"{pair}_{end}" for pair in CLIMATE_PAIRS for end in ("state_topic", "state_template")}
    - {"preset_mode_state_template"}
    | {
        "preset_mode_value_template",
        "action_topic",
        "action_template",
        "current_temperature_topic",
        "current_temperature_template",
        "current_humidity_topic",
        "current_humidity_template",
        "power_command_topic",
        "power_command_template",
        "modes",
        "fan_modes",
        "preset_modes",
        "swing_modes",
        "min_temp",
        "max_temp",
        "temp_step",
        "precision",
        "initial",
        "min_humidity",
        "max_humidity",
        "temperature_unit",
        "optimistic",
        "payload_on",
        "payload_off",
        "retain",
        "value_template",
    },
    "sensor": READ_ONLY
    | {
        "device_class",
        "expire_after",
        "force_update",
        "last_reset_value_template",
        "options",
        "state_class",
        "suggested_display_precision",
        "unit_of_measurement",
    },
    "binary_sensor": READ_ONLY
    | {"device_class", "expire_after", "force_update", "off_delay", "payload_on", "payload_off"},
    "button": {"command_topic", "command_template", "device_class", "payload_press", "retain"},
    "switch": READ_WRITE
    | {
        "command_template",
        "device_class",
        "optimistic",
        "payload_on",
        "payload_off",
        "state_on",
        "state_off",
    },
    "number": READ_WRITE
    | {
        "command_template",
        "device_class",
        "min",
        "max",
        "step",
        "mode",
        "optimistic",
        "payload_reset",
        "unit_of_measurement",
    },
    "text": READ_WRITE | {"command_template", "max", "min", "mode", "pattern"},
}
REQUIRED = {
    "climate": set(),
    "sensor": {"state_topic"},
    "binary_sensor": {"state_topic"},
    "button": {"command_topic"},
    "switch": {"command_topic"},
    "number": {"command_topic"},
    "text": {"command_topic"},
}
HVAC_MODES = {"off", "heat", "cool", "heat_cool", "auto", "dry", "fan_only"}
UNITS = {
    "temperature": {"°C", "°F", "K"},
    "humidity": {"%"},
    "moisture": {"%"},
    "carbon_dioxide": {"ppm"},
    "duration": {"d", "h", "min", "s", "ms", "μs"},
}
BINARY_CLASSES = {"connectivity", "opening", "problem", "running", "safety", "heat", "power"}
CATEGORIES = {"config", "diagnostic"}


def check_topic(topic: str) -> None:
    """A discovery topic Home Assistant listens to."""
    _, kind, object_id, end = topic.split("/")
    assert (kind, end) == ("device", "config")
    assert ID.fullmatch(object_id)


def check_device(payload: dict[str, Any]) -> None:
    """Errors: AssertionError naming the key."""
    _known("root", payload, ROOT)
    assert {"device", "origin", "components"} <= payload.keys()
    _known("device", payload["device"], DEVICE)
    assert payload["device"].get("identifiers") or payload["device"].get("connections")
    _known("origin", payload["origin"], ORIGIN)
    assert payload["origin"]["name"]
    assert not ("availability" in payload and "availability_topic" in payload)
    assert payload.get("qos", 0) in (0, 1, 2)
    shared = {key: payload[key] for key in ("state_topic", "command_topic") if key in payload}
    components = alive(payload)
    ids = [component["unique_id"] for component in components.values()]
    assert len(set(ids)) == len(ids), "unique ids must be unique"
    for entry in payload.get("availability", ()):
        _known("availability", entry, AVAILABILITY_ENTRY)
    for key, component in components.items():
        assert ID.fullmatch(key), key
        # The availability of the root is handed down too, and a list and a topic exclude each other.
        assert not (component.keys() | payload.keys() >= {"availability", "availability_topic"}), key
        _check_component(key, component, shared)


def alive(payload: dict[str, Any]) -> dict[str, Any]:
    """Return the components without those that the payload removes, which are a platform alone."""
    return {key: values for key, values in payload["components"].items() if values.keys() != {"platform"}}


def _check_component(key: str, component: dict[str, Any], shared: dict[str, Any]) -> None:
    platform = component["platform"]
    _known(key, component, ENTITY | PLATFORMS[platform])
    # The topics of the root are handed down to a component that does not give its own.
    assert REQUIRED[platform] <= component.keys() | shared.keys(), f"{key}: misses {REQUIRED[platform]}"
    # Without a template a text on a JSON topic shows nothing, and each message is logged as too long.
    if platform == "text" and "state_topic" in component.keys() | shared.keys():
        assert "value_template" in component, f"{key}: a text without a template for its state"
    assert ID.fullmatch(component["unique_id"])
    assert ENTITY_ID.fullmatch(component["default_entity_id"]), component["default_entity_id"]
    assert component["default_entity_id"].startswith(f"{platform}.")
    assert component.get("entity_category", "config") in CATEGORIES
    assert not (platform in ("sensor", "binary_sensor") and component.get("entity_category") == "config")
    for entry in component.get("availability", ()):
        _known(f"{key}.availability", entry, AVAILABILITY_ENTRY)
        assert entry["topic"]
    for name, value in component.items():
        if name.endswith("_topic"):
            assert value and "#" not in value and "+" not in value, f"{key}.{name}"
        if name.endswith("_template"):
            assert value.count("{{") == value.count("}}") >= 1, f"{key}.{name}"
    {"climate": _check_climate, "sensor": _check_sensor, "binary_sensor": _check_binary}.get(
        platform, lambda key, component: None
    )(key, component)


def _check_climate(key: str, climate: dict[str, Any]) -> None:
    assert set(climate["modes"]) <= HVAC_MODES
    assert ("preset_modes" in climate) == ("preset_mode_command_topic" in climate)
    assert "none" not in climate.get("preset_modes", [])
    assert climate["min_temp"] < climate["max_temp"]
    assert climate["precision"] in (0.1, 0.5, 1.0)
    assert climate.get("temperature_unit", "C") in ("C", "F")
    assert "device_class" not in climate


def _check_sensor(key: str, sensor: dict[str, Any]) -> None:
    if "device_class" in sensor:
        assert sensor["unit_of_measurement"] in UNITS[sensor["device_class"]], key
    assert sensor.get("state_class", "measurement") in ("measurement", "total", "total_increasing")
    if "state_class" not in sensor:  # text
        assert not sensor.keys() & {"unit_of_measurement", "suggested_display_precision"}, key
    assert isinstance(sensor.get("expire_after", 1), int), key
    assert isinstance(sensor.get("suggested_display_precision", 0), int), key


def _check_binary(key: str, sensor: dict[str, Any]) -> None:
    assert sensor.get("device_class", "problem") in BINARY_CLASSES, key


def _known(place: str, given: dict[str, Any], known: set[str]) -> None:
    assert given.keys() <= known, f"{place}: unknown keys {given.keys() - known}"
