"""A daemon on the virtual board whose twin believes in a fifth of its fan: told in history and by MQTT."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from bundles import FACTS, Workshop, install

from bench.drift_alarms import with_fan
from edge.app import daemon
from edge.app.nightly_diagnosis import NightlyDiagnosis
from edge.bundle.keeper import carry_out
from edge.bundle.predictors import loader
from edge.bundle.sign import sign_folder
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.config import loading as config
from edge.core.controller import Context
from edge.core.messages import Command, Decision, DriftState, TickRecord
from edge.drift import monitor
from edge.twin.twin_file import read_twin_file, write_twin_file
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from training.lab import Lab

pytestmark = pytest.mark.slow

MINUTES = 50
SETTLED_S = 600.0  # the simulated box begins at rest, as the filter does: an hour would prove no more
ROOT = "greenhouse/rig-1"
YAML = """
state_file: {folder}/state.json
control_socket: {{path: {folder}/control.sock}}
history: {{path: {folder}/history.db}}
board: {{port: {folder}/board}}
bundle: {{path: {folder}/bundles, trusted_keys: {folder}/trusted}}
timezone: UTC
box: {{heater_w: 100}}
drift: {{diagnose: disagrees, diagnose_at: "00:45", false_alarm_days: 1, reports: {folder}/reports}}
mqtt: {{enabled: {enabled}, host: 127.0.0.1, port: {port}, rig: rig-1}}
"""


class Blows:
    """A controller that heats and blows at once: warm air leaves, and the twin has to know how much."""

    name = "blows"

    def decide(self, context: Context) -> Decision:
        return Decision(Command(heater_duty=0.8, fan_on=True), self.name)

    def reset(self) -> None:
        """Nothing is remembered."""


def rig_with_fan(folder: Path, share: float) -> None:
    """Install and activate a bundle whose twin is the packaged one, its fan so many times as effective."""
    shop = Workshop(folder)
    models = shop.models()
    file = read_twin_file(PACKAGED_FOLDER / "twin.yaml")
    place = ("effects", "fan_effectiveness", "eps_f")
    value = with_fan(file.twin(), share).effects["fan_effectiveness"]["eps_f"]
    write_twin_file(file.with_values({place: type(file.values()[place])(value)}), models / "twin.yaml")
    sign_folder(models, FACTS, shop.key)
    store = BundleStore(folder / "bundles", shop.trusted, loader(60.0))
    install(store, models)
    for action in ("activate", "mark-good"):  # good: nothing runs beside it
        carry_out(store, action, None)


def ran(folder: Path, share: float, mqtt_port: int | None = None) -> list[TickRecord]:
    """MINUTES of the daemon as fast as it goes."""
    rig_with_fan(folder, share)
    enabled = str(mqtt_port is not None).lower()
    settings = config.parse(YAML.format(folder=folder, enabled=enabled, port=mqtt_port or 1883), "test")
    with Lab(settings, board="here", folder=folder, experiment=Blows.name, more_controllers=[Blows()]) as lab:
        lab.run(MINUTES)
    return lab.history


def stored(folder: Path) -> list[tuple[str, str]]:
    """Key and text of the drift monitor's and the diagnosis's events in the history."""
    with closing(sqlite3.connect(folder / "history.db")) as history:
        query = (
            "SELECT key, text FROM events "
            "WHERE key GLOB 'twin.*' OR key GLOB 'drift.*' OR key GLOB 'diagnosis.*' ORDER BY utc"
        )
        return history.execute(query).fetchall()


@pytest.fixture(autouse=True)
def _soon_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monitor, "SETTLE_S", SETTLED_S)
    # What is called at night is tested in test_nightly_diagnosis.py; here only that it is, and ends.
    monkeypatch.setattr(
        daemon, "NightlyDiagnosis", partial(NightlyDiagnosis, program=("sh", "-c", "sleep 60"))
    )


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    (tmp_path / "broker").mkdir()
    with Broker(tmp_path / "broker") as broker:
        yield broker


@needs_mosquitto
def test_a_twin_with_little_of_its_fan_is_told_in_history_and_by_mqtt(tmp_path: Path, broker: Broker) -> None:
    with Listener(broker.port, f"{ROOT}/#") as listener:
        records = ran(tmp_path, 0.2, broker.port)
        wait_for(lambda: any(drift["state"] == "disagrees" for drift in listener.objects(f"{ROOT}/drift")))
        told = listener.objects(f"{ROOT}/drift")[-1]
        events = [event["key"] for event in listener.objects(f"{ROOT}/event")]
    (first, text), *later = stored(tmp_path)
    assert first == "twin.disagrees"
    assert later[0][0] == "diagnosis.started"
    assert "colder than it expects" in text
    assert "twin.disagrees" in events
    assert told["state"] == "disagrees"
    assert told["since_utc"] is not None
    assert told["regimes"]["fan_on"]["error_k"] < 0.0
    assert records[-1].drift is not None
    assert records[-1].drift.state is DriftState.DISAGREES


def test_without_a_mismatch_nothing_is_told(tmp_path: Path) -> None:
    records = ran(tmp_path, 1.0)
    assert stored(tmp_path) == []
    judged = [record.drift.state for record in records if record.drift and not record.drift.reason]
    assert len(judged) > MINUTES // 2
    assert set(judged) == {DriftState.AGREES}
    assert (tmp_path / "drift.json").exists()
