"""edge/mqtt/discovery.py: what Home Assistant is told of a rig, and what it sends."""

import json
import re
from dataclasses import replace
from datetime import datetime, timedelta

import pytest
from home_assistant import alive, check_device, check_topic

from edge.assistant.requests.desk import nothing_asked
from edge.config.settings import BoxSettings, ControlSettings, LlmSettings, ReferenceSettings, Settings
from edge.core.controller_names import LLM
from edge.core.errors import RequestError
from edge.core.messages import ForecastSkill
from edge.mqtt import discovery, states
from edge.mqtt.commands import parse
from edge.mqtt.discovery import PREDICTORS
from edge.mqtt.topics import Topics
from tests.support.mqtt_rig import ROOT, ControlLoop, record, settings

CONFIGURED = settings()
PAYLOAD = discovery.device(CONFIGURED)
COMPONENTS = alive(PAYLOAD)
STATE = states.state(ControlLoop().status(), {"ticks_late": 0, "ticks_skipped": 0, "outbox_depth": 0})


def test_the_payload_is_what_home_assistant_accepts():
    check_topic(Topics.of(CONFIGURED.mqtt).discovery)
    check_device(json.loads(json.dumps(PAYLOAD, allow_nan=False)))


@pytest.mark.parametrize("rig", ["a", "Rig_2", "GREENHOUSE-1", "-x-", "x" * 64, "-"])
def test_it_stays_so_for_every_name_a_rig_can_have(rig):
    configured = settings(rig=rig)
    check_topic(Topics.of(configured.mqtt).discovery)
    check_device(discovery.device(configured))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda payload: payload.update(dev={}),
        lambda payload: payload["device"].update(identifiers=[]),
        lambda payload: payload["origin"].pop("name"),
        lambda payload: payload["components"]["climate"].update(object_id="x"),
        lambda payload: payload["components"]["climate"]["preset_modes"].append("none"),
        lambda payload: payload["components"]["climate"].update(device_class="temperature"),
        lambda payload: payload["components"]["temp_air"].update(unit_of_measurement="degC"),
        lambda payload: payload["components"]["fan"].update(unique_id="rig-1_climate"),
        lambda payload: payload["components"]["clear_trip"].pop("command_topic"),
        lambda payload: payload["components"]["ask"].pop("value_template"),
    ],
)
def test_the_checker_can_fail(spoil):
    payload = json.loads(json.dumps(PAYLOAD))
    spoil(payload)
    with pytest.raises((AssertionError, KeyError)):
        check_device(payload)


def test_the_climate_has_what_the_rig_can_do():
    climate = COMPONENTS["climate"]
    assert climate["modes"] == ["off", "heat", "fan_only", "auto"]
    assert climate["fan_modes"] == ["auto", "on", "off"]
    assert climate["preset_modes"] == list(CONFIGURED.controllers)
    bounds = (CONFIGURED.reference.min_c, CONFIGURED.reference.max_c)
    assert (climate["min_temp"], climate["max_temp"]) == bounds


def test_a_rig_offers_language_models_where_it_has_one():
    def offered(rig: Settings) -> set[str]:
        return set(discovery.device(rig)["components"]["climate"]["preset_modes"])

    with_one = replace(CONFIGURED, llm=LlmSettings(url="http://localhost/v1", model="m"))
    assert not offered(CONFIGURED) & set(LLM)
    assert offered(with_one) >= set(LLM)


def test_all_shown_on_the_state_topic_is_in_the_state():
    keys = {
        key
        for component in COMPONENTS.values()
        for name, template in component.items()
        if name.endswith("_template")
        and name not in ("command_template", "json_attributes_template")
        and component.get("state_topic", ROOT + "/state") == ROOT + "/state"
        for key in re.findall(r"value_json\.(\w+)", template)
    }
    assert keys
    assert keys <= STATE.keys()


def test_every_value_a_climate_can_be_sent_is_a_command():
    climate = COMPONENTS["climate"]
    offered = [
        *((climate["mode_command_topic"], mode) for mode in climate["modes"]),
        *((climate["fan_mode_command_topic"], mode) for mode in climate["fan_modes"]),
        *((climate["preset_mode_command_topic"], mode) for mode in climate["preset_modes"]),
        (climate["temperature_command_topic"], str(climate["min_temp"])),
        (climate["temperature_command_topic"], str(climate["max_temp"])),
    ]
    for topic, payload in offered:
        assert parse_topic(topic, payload)


def test_a_cleared_preset_asks_for_the_configured_controller():
    # Home Assistant offers "none" beside the presets and sends it to clear one.
    topic = COMPONENTS["climate"]["preset_mode_command_topic"]
    assert parse_topic(topic, "none") == {"do": "set_controller", "name": None}


def test_every_button_switch_and_number_ends_in_a_command():
    for component in COMPONENTS.values():
        topic = component.get("command_topic")
        match component["platform"]:
            case "button" if "command_template" not in component:
                assert parse_topic(topic, component["payload_press"])
            case "switch":
                assert parse_topic(topic, component["payload_on"])
                assert parse_topic(topic, component["payload_off"])
            case "number":
                for value in (component["min"], component["max"]):
                    text = component["command_template"].replace("{{ value / 100 }}", str(value / 100))
                    assert parse_topic(topic, text)


WISHES = ("ask", "proposal", "confirm_proposal", "discard_proposal", "undo")


def test_wishes_are_switched_off_where_there_is_no_language_model():
    def enabled(rig: Settings) -> set[bool]:
        components = discovery.device(rig)["components"]
        return {components[key]["enabled_by_default"] for key in WISHES}

    assert enabled(CONFIGURED) == {False}
    assert enabled(replace(CONFIGURED, llm=LlmSettings(url="http://localhost/v1", model="m"))) == {True}


def test_a_box_that_nobody_described_has_no_button_that_commissions_it():
    def enabled(rig: Settings) -> set[bool]:
        components = discovery.device(rig)["components"]
        keys = ("commission", "end_commissioning", "commissioning")
        return {components[key]["enabled_by_default"] for key in keys}

    assert enabled(CONFIGURED) == {False}
    assert enabled(replace(CONFIGURED, box=BoxSettings(twin="twin.yaml"))) == {True}


NOW = datetime(2026, 7, 1, 12, 0, 0)


def proposal_attributes(key, **proposal):
    jinja2 = pytest.importorskip("jinja2")
    template = jinja2.Environment().from_string(COMPONENTS[key]["json_attributes_template"])
    return json.loads(template.render(value_json={**nothing_asked(), **proposal}, now=lambda: NOW))


@pytest.mark.parametrize("what", ["confirm", "discard"])
@pytest.mark.parametrize(
    ("id", "age_s", "payload"),
    [("c0ffee", 60.0, "c0ffee"), ("c0ffee", 1.0, "c0ffee"), ("c0ffee", 0.9, ""), ("", 60.0, "")],
    ids=["read", "just read", "too new to have been read", "none"],
)
def test_a_button_names_the_proposal_that_home_assistant_shows(what, id, age_s, payload):
    jinja2 = pytest.importorskip("jinja2")
    button = COMPONENTS[f"{what}_proposal"]
    template = jinja2.Environment().from_string(button["command_template"])
    this = {"attributes": proposal_attributes(f"{what}_proposal", id=id)}
    sent = template.render(this=this, now=lambda: NOW + timedelta(seconds=age_s))
    assert sent == payload
    if sent:
        assert parse_topic(button["command_topic"], sent) == {"do": what, "id": "c0ffee"}
    else:
        with pytest.raises(RequestError, match="no proposal is named"):
            parse_topic(button["command_topic"], sent)


def test_the_buttons_are_there_while_a_proposal_waits():
    jinja2 = pytest.importorskip("jinja2")
    root, own = COMPONENTS["confirm_proposal"]["availability"]
    assert root == PAYLOAD["availability"][0]
    template = jinja2.Environment().from_string(own["value_template"])
    shown = {state: template.render(value_json={"state": state}) for state in ("ready", "none", "expired")}
    assert shown == {"ready": "online", "none": "offline", "expired": "offline"}


def test_the_stage_of_a_proposal_is_an_attribute():
    # `state` is a name that Home Assistant drops, core: components/mqtt/entity.py, MQTT_ATTRIBUTES_BLOCKED
    shown = proposal_attributes("proposal", state="ready", lines=["26 °C"])
    assert (shown["stage"], shown["lines"]) == ("ready", ["26 °C"])


def test_what_the_proposal_shows_is_in_a_proposal():
    for key, name in (("proposal", "text"), ("ask", "words")):
        assert COMPONENTS[key]["value_template"] == f"{{{{ value_json.{name}[:255] }}}}"
        assert name in nothing_asked()
    assert parse_topic(COMPONENTS["ask"]["command_topic"], "keep 26")["words"] == "keep 26"


def test_what_an_older_version_announced_is_removed_and_its_stop_goes_on():
    # Home Assistant removes a component that is its platform alone.
    assert {key: values for key, values in PAYLOAD["components"].items() if key not in COMPONENTS} == {
        "confirm": {"platform": "text"}
    }
    for key, platform in (("emergency_stop", "button"), ("release_emergency_stop", "button")):
        assert COMPONENTS[key]["platform"] == platform
        assert not COMPONENTS[key]["enabled_by_default"]  # of a new rig


def test_one_switch_stops_and_releases_and_shows_it():
    switch = COMPONENTS["stop"]
    assert parse_topic(switch["command_topic"], switch["payload_on"]) == {"do": "emergency_stop"}
    assert parse_topic(switch["command_topic"], switch["payload_off"]) == {"do": "release_emergency_stop"}
    assert rendered("stop", STATE) == switch["state_off"]
    assert rendered("stop", {**STATE, "emergency_stop": 1}) == switch["state_on"]


def test_every_entity_has_an_icon_of_ours_or_one_that_changes_with_its_state():
    for key, component in COMPONENTS.items():
        if component["platform"] == "binary_sensor":
            assert component["device_class"]
        else:
            assert re.fullmatch(r"mdi:[a-z0-9-]+", component["icon"]), key


@pytest.mark.parametrize(
    ("answer", "shown"),
    [
        ({"command": "mode", "ok": True}, "mode: done"),
        ({"command": "mode", "ok": False, "error": "'x' is not one of off"}, "mode: 'x' is not one of off"),
        ({"command": "", "ok": False}, ": refused"),
    ],
)
def test_a_refusal_is_shown(answer, shown):
    assert rendered("last_answer", answer) == shown
    assert len(rendered("last_answer", {"command": "c" * 43, "ok": False, "error": "e" * 999})) <= 255


def test_sensors_expire_after_three_steps():
    slow = replace(CONFIGURED, control=replace(ControlSettings(), step_s=60.0))
    quick = replace(CONFIGURED, control=replace(ControlSettings(), step_s=1.0))
    assert discovery.device(slow)["components"]["temp_air"]["expire_after"] == 180
    assert discovery.device(quick)["components"]["temp_air"]["expire_after"] == 30


def test_ids_stay_the_same_when_only_the_settings_change():
    other = replace(CONFIGURED, reference=ReferenceSettings(min_c=18.0))
    ids = {key: component["unique_id"] for key, component in COMPONENTS.items()}
    again = alive(discovery.device(other))
    assert ids == {key: component["unique_id"] for key, component in again.items()}


def parse_topic(topic: str, payload: str):
    root, _, what = topic.rpartition("/")
    assert root == f"{ROOT}/set"
    return parse(what, payload.encode(), CONFIGURED.reference)


# sensors of the skill

ROW = ForecastSkill("arx", "v1", 15, 7, 0.214, 0.905, None, 0.5, 0.91)


def skill_payload(*rows):
    loop = ControlLoop()
    loop.last_record = record(skill=rows)
    return json.loads(json.dumps(states.skill(loop.status()), allow_nan=False))


def rendered(key, shown, template="value_template"):
    """As Home Assistant renders it; "None" is shown as unknown."""
    jinja2 = pytest.importorskip("jinja2")
    return jinja2.Environment().from_string(COMPONENTS[key][template]).render(value_json=shown)


def test_every_predictor_has_its_diagnostics_on_the_topic_of_the_skill():
    for name in PREDICTORS:
        for key in (f"error_{name}", f"skill_{name}"):
            assert COMPONENTS[key]["state_topic"] == Topics.of(CONFIGURED.mqtt).skill
            assert COMPONENTS[key]["entity_category"] == "diagnostic"
    check_device(discovery.device(CONFIGURED))


def test_error_is_in_kelvin_and_skill_in_percent():
    assert (rendered("error_arx", skill_payload(ROW)), COMPONENTS["error_arx"]["unit_of_measurement"]) == (
        "0.214",
        "K",
    )
    assert (rendered("skill_arx", skill_payload(ROW)), COMPONENTS["skill_arx"]["unit_of_measurement"]) == (
        "90.5",
        "%",
    )


@pytest.mark.parametrize("rows", [(), (ForecastSkill("arx", "v1", 60, 7, 0.2, 0.9, None, None, None),)])
@pytest.mark.parametrize("key", ["error_arx", "skill_arx", "error_ham"])
def test_what_was_not_scored_is_unknown(rows, key):
    assert rendered(key, skill_payload(*rows)) == "None"


def test_a_skill_that_does_not_exist_is_unknown():
    shown = skill_payload(ForecastSkill("arx", "v1", 15, 7, 0.0, None, None, None, None))
    assert (rendered("skill_arx", shown), rendered("error_arx", shown)) == ("None", "0.0")


def test_all_horizons_are_attributes():
    shown = json.loads(rendered("error_arx", skill_payload(ROW), "json_attributes_template"))
    assert shown["horizons"]["15"]["covered"] == 0.91
    assert json.loads(rendered("error_ham", skill_payload(ROW), "json_attributes_template")) == {}
