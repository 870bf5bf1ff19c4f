import json
import ssl
import subprocess
from pathlib import Path

import pytest
from certificates import make_certificates

from edge.mqtt.telemetry import Telemetry
from edge.mqtt.topics import Topics
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ControlLoop, MemoryOutbox, OutboxRow, record, settings, tick

pytestmark = needs_mosquitto
DEPLOY = Path(__file__).parents[2] / "deploy"
ROOT = "greenhouse/greenhouse-1"


@pytest.fixture
def broker(tmp_path):
    """The example as it is, but for its folders and its port."""
    make_certificates(tmp_path / "certs")
    (tmp_path / "greenhouse.acl").write_text((DEPLOY / "mosquitto.acl.example").read_text())
    for option, user in (["-c"], "greenhouse-1"), ([], "homeassistant"), ([], "archive"):
        passwd = str(tmp_path / "passwd")
        subprocess.run(["mosquitto_passwd", *option, "-b", passwd, user, user], check=True)
    config = (DEPLOY / "mosquitto.conf.example").read_text().replace("/etc/mosquitto", str(tmp_path))
    lines = [
        line for line in config.splitlines() if not line.startswith(("listener", "persistence_location"))
    ]
    with Broker(tmp_path, "\n".join(lines)) as running:
        yield running


class EmptyOutbox(MemoryOutbox):
    def pending(self, limit):
        return [OutboxRow(row.id, f"{ROOT}/history/tick", row.payload) for row in super().pending(limit)]


def test_the_rig_home_assistant_and_an_archive_can_do_their_work_and_no_more(broker, tmp_path):
    authority = str(tmp_path / "certs" / "ca.crt")
    context = ssl.create_default_context(cafile=authority)
    secret = tmp_path / "secret"
    secret.write_text("greenhouse-1\n")
    secret.chmod(0o600)
    configured = settings(
        broker.port,
        rig="greenhouse-1",
        tls=True,
        ca=authority,
        username="greenhouse-1",
        password_file=str(secret),
    )
    loop, outbox = ControlLoop(), EmptyOutbox(50)
    with (
        Listener(broker.port, user="homeassistant", password="homeassistant", context=context) as home,
        Listener(broker.port, user="archive", password="archive", context=context, name="archive") as archive,
    ):
        own = Telemetry(configured, loop.ask, loop.post, lambda: outbox)
        try:
            tick(own, record(), loop)
            wait_for(lambda: home.objects(f"{ROOT}/state") and home.objects(f"{ROOT}/decision"))
            wait_for(lambda: home.objects("homeassistant/device/greenhouse-1/config"))
            own.show_proposal({"id": "a1"})
            own.show_commissioning({"phase": "idle", "text": "idle"})
            wait_for(lambda: home.objects(f"{ROOT}/proposal")[-1:] == [{"id": "a1"}])
            written = Topics.of(configured.mqtt).retained  # each has a line in the file
            wait_for(lambda: all(home.payloads(topic) for topic in written))
            wait_for(lambda: len(archive.objects(f"{ROOT}/history/tick")) == 50)
            wait_for(lambda: outbox.depth() == 0)
            archive.send(f"{ROOT}/set/mode", "off")  # not its business
            home.send(f"{ROOT}/set/mode", "heat")
            wait_for(lambda: home.objects(f"{ROOT}/reply"))
            assert loop.requests == [{"do": "set_mode", "mode": "heat"}]
            span = {"first_seq": 1, "last_seq": 2}
            archive.send(f"{ROOT}/set/resend", json.dumps(span))
            answer = {"command": "resend", "ok": True, "queued": 0, **span}
            wait_for(lambda: archive.objects(f"{ROOT}/reply")[-1:] == [answer])
            assert not own.faults()
        finally:
            own.close()
        assert not archive.payloads(f"{ROOT}/state")
