"""Home Assistant device-based discovery: one retained message that describes the whole rig.

Keys are written in full: the abbreviations changed between versions. Source: Home Assistant core,
`components/mqtt/schemas.py` and the schema of each platform.
"""

import math
import re
from typing import Any

from edge.config.settings import Settings
from edge.core.hard_limits import MAINTENANCE_MAX_MIN
from edge.core.names import HEATER_LEVELS, SIGNALS, Signal
from edge.core.version import __version__
from edge.mqtt.commands import OFF, ON, PRESS
from edge.mqtt.icons import icon_of
from edge.mqtt.states import LINE_COUNTERS
from edge.mqtt.topics import Topics
from edge.tick.orders import FanMode

Json = dict[str, Any]

PREDICTORS = {"arx": "ARX", "pbm": "PBM", "lstm": "LSTM", "ham": "HAM"}  # one that does not run is unknown
SHOWN_MIN = 15  # about as far as an MPC looks, and no step shorter than 9 s is too short for it


def skill_sensors(topics: Topics) -> dict[str, Json]:
    """Components by key, on the topic of the skill."""
    sensors: dict[str, Json] = {}
    for name, label in PREDICTORS.items():
        row = f"value_json.predictors.get('{name}', {{}}).get('horizons', {{}}).get('{SHOWN_MIN}', {{}})"
        share = f"{row}.get('against_persistence')"
        sensors[f"error_{name}"] = {
            **_skill_diagnostic(topics, name, f"Error of {label} in {SHOWN_MIN} min", 3),
            "value_template": f"{{{{ {row}.get('mae_k') }}}}",
            "unit_of_measurement": "K",
        }
        sensors[f"skill_{name}"] = {
            **_skill_diagnostic(topics, name, f"Skill of {label} in {SHOWN_MIN} min", 0),
            "value_template": f"{{{{ None if {share} is none else ({share} * 100) | round(1) }}}}",
            "unit_of_measurement": "%",
        }
    return sensors


def _skill_diagnostic(topics: Topics, name: str, label: str, digits: int) -> Json:
    return {
        "platform": "sensor",
        "name": label,
        "state_topic": topics.skill,
        "state_class": "measurement",
        "suggested_display_precision": digits,
        "json_attributes_topic": topics.skill,
        "json_attributes_template": f"{{{{ value_json.predictors.get('{name}', {{}}) | tojson }}}}",
        "entity_category": "diagnostic",
    }


CLIMATE_MODES = ("off", "heat", "fan_only", "auto")
MAINTENANCE_MIN = 30  # what the switch asks for; it ends by itself
EXPIRE_STEPS = 3  # values this many control steps old are shown as unavailable
EXPIRE_MIN_S = 30
ENTITY_TEXT_MAX = 255  # a state holds no more
READ_S = 1  # a proposal younger than this cannot have been read
RETIRED = {"confirm": "text"}  # components of older versions -> platform: Home Assistant removes them
AVAILABLE, NOT_AVAILABLE = "online", "offline"


def device(settings: Settings) -> Json:
    """Return the payload for `Topics.discovery`."""
    topics = Topics.of(settings.mqtt)
    return {
        "device": {
            "identifiers": [settings.mqtt.rig],
            "name": settings.mqtt.rig,
            "model": "Miniature greenhouse",
            "manufacturer": "greenhouse-twin",
            "sw_version": __version__,
        },
        "origin": {"name": "greenhouse-twin", "sw_version": __version__},
        # A list, since a component's own list can replace it, and not a topic.
        "availability": [_available(topics)],
        "availability_mode": "all",
        "components": {
            **_components(settings, topics),
            **{key: {"platform": platform} for key, platform in RETIRED.items()},
        },
    }


def _available(topics: Topics) -> Json:
    return {
        "topic": topics.availability,
        "payload_available": AVAILABLE,
        "payload_not_available": NOT_AVAILABLE,
    }


def _components(settings: Settings, topics: Topics) -> Json:
    expire_s = max(EXPIRE_MIN_S, math.ceil(EXPIRE_STEPS * settings.control.step_s))
    groups = (
        {"climate": _climate(settings, topics)},
        {
            key: {"expire_after": expire_s, **sensor}
            for key, sensor in {**_sensors(topics), **skill_sensors(topics)}.items()
        },
        # Who decided the last step is not always the chosen one.
        {"controller": _text_sensor("Decided by", topics.decision, _value("controller"))},
        {"last_event": _text_sensor("Last event", topics.event, _text("text"))},
        {"last_answer": _answer_sensor(topics)},
        {**_binary_sensors(topics), "twin_disagrees": _drift_sensor(topics)},
        _buttons(topics),
        _inputs(topics),
        _wishes(settings, topics),
        _commissioning(settings, topics),
    )
    rig = settings.mqtt.rig
    # Home Assistant makes ids of names; ours are given, so that a later name does not break a dashboard.
    slug = re.findall("[a-z0-9]+", rig.lower())
    return {
        key: {
            **component,
            **icon_of(key, component),
            "unique_id": f"{rig}_{key}",
            "default_entity_id": f"{component['platform']}.{'_'.join([*slug, key])}",
            "qos": 1,  # at the root it reaches the entities in some versions only
        }
        for group in groups
        for key, component in group.items()
    }


def _climate(settings: Settings, topics: Topics) -> Json:
    state = topics.state
    return {
        "platform": "climate",
        # The device's main feature carries the device's name.
        "name": None,
        "modes": list(CLIMATE_MODES),
        "mode_command_topic": topics.command("mode"),
        "mode_state_topic": state,
        "mode_state_template": _value("hvac_mode"),
        "temperature_command_topic": topics.command("temperature"),
        "temperature_state_topic": state,
        "temperature_state_template": _value("reference_c"),
        "temperature_unit": "C",
        "min_temp": settings.reference.min_c,
        "max_temp": settings.reference.max_c,
        "temp_step": 0.5,
        "precision": 0.1,
        "current_temperature_topic": state,
        "current_temperature_template": _value("temp_air_c"),
        "current_humidity_topic": state,
        "current_humidity_template": _value("rel_humidity_pct"),
        "action_topic": state,
        "action_template": _value("action"),
        "fan_modes": [mode.value for mode in FanMode],
        "fan_mode_command_topic": topics.command("fan_mode"),
        "fan_mode_state_topic": state,
        "fan_mode_state_template": _value("fan_mode"),
        "preset_modes": list(settings.controllers),
        "preset_mode_command_topic": topics.command("controller"),
        "preset_mode_state_topic": state,
        "preset_mode_value_template": _value("controller"),
    }


def _sensors(topics: Topics) -> dict[str, Json]:
    sensors = {
        **{name: _signal(signal) for name, signal in SIGNALS.items()},
        "estimate": _sensor("Estimated air temperature", _value("estimate_c"), "°C", "temperature", 2),
        "reference": _sensor("Reference", _value("reference_c"), "°C", "temperature", 1),
        "heater_duty": _sensor("Heater duty", _percent("heater_duty"), "%", None, 0),
        "led": _sensor("LED light", _percent("led"), "%", None, 0),
        "tick_late": _diagnostic("Start of tick late by", "late_s", "s", "duration", 3),
        "decide_time": _diagnostic("Decision time", "decide_ms", "ms", "duration", 1),
        "ticks_late": _counter("Late ticks", "ticks_late"),
        "ticks_skipped": _counter("Skipped ticks", "ticks_skipped"),
        "outbox_depth": _diagnostic("Messages waiting", "outbox_depth", None, None, 0),
        **{f"line_{key}": _counter(name, f"line_{key}") for key, name in LINE_COUNTERS.items()},
    }
    return {key: {**sensor, "state_topic": topics.state} for key, sensor in sensors.items()}


def _signal(signal: Signal) -> Json:
    name = signal.label.partition(" (")[0]
    if signal.unit == "1":
        return _sensor(name, _percent(signal.key), "%", signal.device_class, signal.digits)
    return _sensor(name, _value(signal.key), signal.unit, signal.device_class, signal.digits)


def _sensor(name: str, template: str, unit: str | None, device_class: str | None, digits: int) -> Json:
    sensor: Json = {
        "platform": "sensor",
        "name": name,
        "value_template": template,
        "state_class": "measurement",
        "suggested_display_precision": digits,
    }
    if unit is not None:
        sensor["unit_of_measurement"] = unit
    if device_class is not None:
        sensor["device_class"] = device_class
    return sensor


def _diagnostic(name: str, key: str, unit: str | None, device_class: str | None, digits: int) -> Json:
    return {**_sensor(name, _value(key), unit, device_class, digits), "entity_category": "diagnostic"}


def _counter(name: str, key: str) -> Json:
    return {**_diagnostic(name, key, None, None, 0), "state_class": "total_increasing"}


def _text_sensor(name: str, topic: str, template: str) -> Json:
    """Return a sensor with a text; all of its message is attributes."""
    return {
        "platform": "sensor",
        "name": name,
        "state_topic": topic,
        "value_template": template,
        "json_attributes_topic": topic,
        "entity_category": "diagnostic",
    }


def _answer_sensor(topics: Topics) -> Json:
    """Return the answer to the last order over MQTT, so that a refusal can be seen where it was given."""
    refused = f"value_json.command ~ ': ' ~ value_json.get('error', 'refused')[:{ENTITY_TEXT_MAX - 45}]"
    done = f"value_json.get('message', value_json.command ~ ': done')[:{ENTITY_TEXT_MAX}]"
    return _text_sensor("Last answer", topics.reply, f"{{{{ {done} if value_json.ok else {refused} }}}}")


def _drift_sensor(topics: Topics) -> Json:
    """On while the running twin disagrees with the box, unknown while it is not judged."""
    states = "{'disagrees': 'ON', 'agrees': 'OFF'}"
    return {
        "platform": "binary_sensor",
        "name": "Twin disagrees",
        "device_class": "problem",
        "state_topic": topics.drift,
        "value_template": f"{{{{ {states}.get(value_json.state) }}}}",
        "payload_on": "ON",
        "payload_off": "OFF",
        "json_attributes_topic": topics.drift,
        "entity_category": "diagnostic",
    }


def _binary_sensors(topics: Topics) -> dict[str, Json]:
    sensors = {
        "fan": _binary("Fan", "fan_on", "running"),
        "valve": _binary("Water valve", "valve_open", "opening"),
        "tripped": _binary("Tripped", "tripped", "problem"),
        "problem": _binary("Problem", "problem", "problem"),
        "link": {**_binary("Board link", "link_up", "connectivity"), "entity_category": "diagnostic"},
        # The switch has taken its place; automations of older versions may still watch it.
        "emergency": {
            **_binary("Emergency stop", "emergency_stop", "safety"),
            "enabled_by_default": False,
        },
    }
    return {key: {**sensor, "state_topic": topics.state} for key, sensor in sensors.items()}


def _binary(name: str, key: str, device_class: str) -> Json:
    return {
        "platform": "binary_sensor",
        "name": name,
        "device_class": device_class,
        # "None" makes the sensor unknown, where the board did not say.
        "value_template": f"{{{{ {{1: 'ON', 0: 'OFF'}}.get(value_json.{key}) }}}}",
        "payload_on": "ON",
        "payload_off": "OFF",
    }


def _buttons(topics: Topics) -> dict[str, Json]:
    """Buttons; those of the emergency stop are left for automations of older versions.

    `enabled_by_default` counts when Home Assistant meets an entity for the first time: one in use goes on.
    """
    names = {
        "emergency_stop": "Emergency stop",
        "release_emergency_stop": "Release emergency stop",
        "clear_trip": "Clear trip",
        "follow_schedule": "Follow the schedule",
    }
    return {
        what: {
            **_button(topics, what, name),
            "enabled_by_default": not what.endswith("emergency_stop"),
        }
        for what, name in names.items()
    }


def _button(topics: Topics, what: str, name: str) -> Json:
    return {
        "platform": "button",
        "name": name,
        "command_topic": topics.command(what),
        "payload_press": PRESS,
    }


def _inputs(topics: Topics) -> dict[str, Json]:
    return {
        "stop": _switch(topics, "emergency_stop", "Emergency stop", ON, OFF),
        # A switch knows no minutes: it asks for as many as a person at the box needs.
        "maintenance": _switch(
            topics, "maintenance", "Maintenance", str(min(MAINTENANCE_MIN, int(MAINTENANCE_MAX_MIN))), "0"
        ),
        "manual_heater_duty": {
            "platform": "number",
            "name": "Manual heater duty",
            "command_topic": topics.command("manual"),
            "command_template": '{"heater_duty": {{ value / 100 }}}',
            "state_topic": topics.state,
            "value_template": _percent("manual_heater_duty"),
            "min": 0,
            "max": 100,
            "step": 100 / HEATER_LEVELS,
            "unit_of_measurement": "%",
            "entity_category": "config",
        },
    }


def _switch(topics: Topics, what: str, name: str, on: str, off: str) -> Json:
    return {
        "platform": "switch",
        "name": name,
        "command_topic": topics.command(what),
        "payload_on": on,
        "payload_off": off,
        "state_topic": topics.state,
        "value_template": _value(what),
        "state_on": "1",
        "state_off": "0",
    }


def _wishes(settings: Settings, topics: Topics) -> dict[str, Json]:
    """Entities for requests in words; without a language model they exist and are disabled.

    The text shows what was asked last, by whomever."""
    wishes: dict[str, Json] = {
        "ask": {
            "platform": "text",
            "name": "Ask",
            "command_topic": topics.command("ask"),
            "state_topic": topics.proposal,
            "value_template": _text("words"),
            "max": ENTITY_TEXT_MAX,
        },
        "proposal": {
            "platform": "sensor",
            "name": "Proposal",
            "state_topic": topics.proposal,
            "value_template": _text("text"),
            "json_attributes_topic": topics.proposal,
            # Home Assistant drops an attribute named `state`.
            "json_attributes_template": "{{ dict(value_json, stage=value_json.state) | tojson }}",
        },
        "confirm_proposal": _about_proposal(topics, "confirm", "Confirm the proposal"),
        "discard_proposal": _about_proposal(topics, "discard", "Discard the proposal"),
        "undo": _button(topics, "undo", "Undo what was confirmed"),
    }
    # Disabled rather than left out: what stands on a dashboard stays there.
    return {key: {**wish, "enabled_by_default": bool(settings.llm.url)} for key, wish in wishes.items()}


def _about_proposal(topics: Topics, what: str, name: str) -> Json:
    """Button that names the proposal which Home Assistant shows, and is there while one waits.

    The id comes from the button's own attributes, so the daemon never guesses which proposal was meant: one
    that has expired or been taken up is refused. A press within a second of a change names none: nobody can
    have read the new proposal, and the press was meant for the one before.
    """
    waits = f"{{{{ '{AVAILABLE}' if value_json.state == 'ready' else '{NOT_AVAILABLE}' }}}}"
    # A press changes `last_updated` before the template is rendered: the moment is an attribute.
    attributes = "{'id': value_json.id, 'proposal': value_json.text, 'since': now().timestamp()}"
    fresh = f"now().timestamp() - this.attributes.get('since', 0) < {READ_S}"
    return {
        "platform": "button",
        "name": name,
        "command_topic": topics.command(what),
        "command_template": f"{{{{ '' if {fresh} else this.attributes.get('id', '') }}}}",
        "json_attributes_topic": topics.proposal,
        "json_attributes_template": f"{{{{ {attributes} | tojson }}}}",
        "availability": [
            _available(topics),
            {
                "topic": topics.proposal,
                "value_template": waits,
                "payload_available": AVAILABLE,
                "payload_not_available": NOT_AVAILABLE,
            },
        ],
        "availability_mode": "all",
    }


def _commissioning(settings: Settings, topics: Topics) -> dict[str, Json]:
    """Entities to learn a new box; without a description of one they exist and are disabled.

    The switch "Maintenance" pauses the tests.
    """
    entities: dict[str, Json] = {
        what: {**_button(topics, what, name), "entity_category": "config"}
        for what, name in {"commission": "Commission", "end_commissioning": "End commissioning"}.items()
    }
    entities["commissioning"] = _text_sensor("Commissioning", topics.commissioning, _value("text"))
    return {key: {**own, "enabled_by_default": bool(settings.box.twin)} for key, own in entities.items()}


def _value(key: str) -> str:
    return f"{{{{ value_json.{key} }}}}"


def _text(key: str) -> str:
    return f"{{{{ value_json.{key}[:{ENTITY_TEXT_MAX}] }}}}"


def _percent(key: str) -> str:
    """Return the template of a share as percent; an unknown one stays unknown."""
    return f"{{{{ None if value_json.{key} is none else (value_json.{key} * 100) | round(1) }}}}"
