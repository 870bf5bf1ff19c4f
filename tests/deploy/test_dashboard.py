"""deploy/home_assistant/dashboard.yaml: every entity on it is announced by a rig, and enabled."""

import re
from dataclasses import replace

import yaml
from home_assistant import alive

from edge.config.settings import LlmSettings
from edge.mqtt import discovery
from tests.support.daemon_process import ROOT
from tests.support.mqtt_rig import settings

TEXT = (ROOT / "deploy" / "home_assistant" / "dashboard.yaml").read_text()
RIG = replace(settings(rig="greenhouse-1"), llm=LlmSettings(url="http://localhost/v1", model="m"))


def test_every_entity_on_the_dashboard_is_announced_and_enabled() -> None:
    shown = set(re.findall(r"\b[a-z_]+\.greenhouse_1_[a-z0-9_]+", TEXT))
    announced = {
        component["default_entity_id"]
        for component in alive(discovery.device(RIG)).values()
        if component.get("enabled_by_default", True)
    }
    assert len(shown) > 20
    assert shown <= announced


def test_the_dashboard_has_no_card_that_somebody_would_have_to_install() -> None:
    assert yaml.safe_load(TEXT)["views"]
    assert "custom:" not in TEXT
