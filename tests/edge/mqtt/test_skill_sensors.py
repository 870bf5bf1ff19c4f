import json

import pytest
from home_assistant import check_device

from bench.support.mqtt_rig import ControlLoop, record, settings
from edge.core.messages import ForecastSkill
from edge.mqtt import discovery, states
from edge.mqtt.discovery import PREDICTORS
from edge.mqtt.topics import Topics

CONFIGURED = settings()
COMPONENTS = discovery.device(CONFIGURED)["components"]
ROW = ForecastSkill("arx", "v1", 15, 7, 0.214, 0.905, None, 0.5, 0.91)


def payload(*rows):
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
    assert (rendered("error_arx", payload(ROW)), COMPONENTS["error_arx"]["unit_of_measurement"]) == (
        "0.214",
        "K",
    )
    assert (rendered("skill_arx", payload(ROW)), COMPONENTS["skill_arx"]["unit_of_measurement"]) == (
        "90.5",
        "%",
    )


@pytest.mark.parametrize("rows", [(), (ForecastSkill("arx", "v1", 60, 7, 0.2, 0.9, None, None, None),)])
@pytest.mark.parametrize("key", ["error_arx", "skill_arx", "error_ham"])
def test_what_was_not_scored_is_unknown(rows, key):
    assert rendered(key, payload(*rows)) == "None"


def test_a_skill_that_does_not_exist_is_unknown():
    still = ForecastSkill("arx", "v1", 15, 7, 0.0, None, None, None, None)
    assert (rendered("skill_arx", payload(still)), rendered("error_arx", payload(still))) == ("None", "0.0")


def test_all_horizons_are_attributes():
    shown = json.loads(rendered("error_arx", payload(ROW), "json_attributes_template"))
    assert shown["horizons"]["15"]["covered"] == 0.91
    assert json.loads(rendered("error_ham", payload(ROW), "json_attributes_template")) == {}
