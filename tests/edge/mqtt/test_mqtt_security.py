import logging
import ssl
import subprocess
from contextlib import closing

import pytest
from certificates import make_certificates

from edge.core.errors import ConfigError
from edge.mqtt.connection import make_client
from edge.mqtt.telemetry import Telemetry
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ROOT, ControlLoop, MemoryOutbox, record, settings, tick

pytestmark = pytest.mark.usefixtures("quick_reconnect")
pytest_plugins = ["rig_places"]

PASSWORD = "correct horse"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    return make_certificates(tmp_path_factory.mktemp("certificates"))


def tls_broker(folder, certificates, extra=""):
    return Broker(
        folder,
        f"allow_anonymous true\ncafile {certificates}/ca.crt\ncertfile {certificates}/broker.crt\n"
        f"keyfile {certificates}/broker.key\n{extra}",
    )


def start(port, **mqtt):
    return Telemetry(settings(port, **mqtt), ControlLoop().ask, ControlLoop().post, MemoryOutbox)


def fault(own):
    return own.faults().get("telemetry.offline", "")


@needs_mosquitto
def test_a_client_certificate_opens_a_broker_that_demands_one(tmp_path, certificates):
    context = ssl.create_default_context(cafile=str(certificates / "ca.crt"))
    context.load_cert_chain(certificates / "client.crt", certificates / "client.key")
    own_files = {"client_cert": certificates / "client.crt", "client_key": certificates / "client.key"}
    files = {key: str(path) for key, path in own_files.items()}
    with (
        tls_broker(tmp_path, certificates, "require_certificate true") as broker,
        Listener(broker.port, context=context) as listener,
        closing(start(broker.port, tls=True, ca=str(certificates / "ca.crt"), **files)) as own,
    ):
        tick(own, record())
        wait_for(lambda: listener.objects(f"{ROOT}/state"))


@needs_mosquitto
@pytest.mark.parametrize(("authority", "host"), [("stranger.crt", "127.0.0.1"), ("ca.crt", "localhost")])
def test_a_certificate_by_a_stranger_or_for_another_host_is_refused(tmp_path, certificates, authority, host):
    with tls_broker(tmp_path, certificates) as broker:
        with closing(start(broker.port, tls=True, ca=str(certificates / authority), host=host)) as own:
            tick(own, record())
            wait_for(lambda: "can't be reached" in fault(own))
        assert "greenhouse" not in broker.log


@pytest.fixture
def password_broker(tmp_path):
    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-c", "-b", str(users), "rig", PASSWORD], check=True)
    subprocess.run(["mosquitto_passwd", "-b", str(users), "home", "home"], check=True)
    access = tmp_path / "acl"
    access.write_text(
        "user rig\ntopic readwrite greenhouse/rig-1/#\ntopic readwrite homeassistant/#\n"
        "user home\ntopic read #\ntopic write greenhouse/+/set/mode\n"
    )
    with Broker(tmp_path, f"allow_anonymous false\npassword_file {users}\nacl_file {access}") as broker:
        yield broker


def password_file(folder, password):
    path = folder / "password"
    path.write_text(password + "\n")
    path.chmod(0o600)
    return str(path)


@needs_mosquitto
def test_the_right_password_opens_the_broker(tmp_path, password_broker):
    secret = password_file(tmp_path, PASSWORD)
    with closing(start(password_broker.port, username="rig", password_file=secret)) as own:
        wait_for(lambda: not fault(own))


@needs_mosquitto
def test_a_wrong_password_is_told_and_tried_again_and_never_shown(tmp_path, password_broker, caplog):
    caplog.set_level(logging.DEBUG)
    secret = password_file(tmp_path, "wrong-secret")
    with closing(start(password_broker.port, username="rig", password_file=secret)) as own:
        wait_for(lambda: "Not authorized" in fault(own) or "Bad user" in fault(own))
        wait_for(lambda: password_broker.log.count("not authorised") >= 2)
    assert "wrong-secret" not in caplog.text + repr(own) + repr(vars(own)) + password_broker.log


@needs_mosquitto
def test_the_access_list_lets_home_assistant_ask_only_what_it_may(password_broker, tmp_path):
    loop = ControlLoop()
    configured = settings(
        password_broker.port, username="rig", password_file=password_file(tmp_path, PASSWORD)
    )
    with (
        closing(Telemetry(configured, loop.ask, loop.post, MemoryOutbox)),
        Listener(password_broker.port, user="home", password="home") as home,
    ):
        wait_for(lambda: home.payloads(f"{ROOT}/availability")[-1:] == [b"online"])
        home.send(f"{ROOT}/set/emergency_stop", "PRESS")
        home.send(f"{ROOT}/set/mode", "off")
        wait_for(lambda: home.objects(f"{ROOT}/reply"))
        assert loop.requests == [{"do": "set_mode", "mode": "off"}]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"tls": True, "ca": "/nowhere/ca.crt"}, r"mqtt\.ca: /nowhere/ca\.crt: No such file"),
        (
            {"username": "rig", "password_file": "/nowhere/password"},
            r"mqtt\.password_file: /nowhere/password",
        ),
        (
            {"tls": True, "client_cert": "/nowhere/a.crt", "client_key": "/nowhere/a.key"},
            r"mqtt\.client_key: /nowhere/a\.key",
        ),
    ],
)
def test_a_missing_file_is_named_at_the_start(change, place):
    with pytest.raises(ConfigError, match=place):
        make_client(settings(**change).mqtt)


def test_a_key_others_can_read_is_refused(tmp_path, certificates):
    key = tmp_path / "open.key"
    key.write_bytes((certificates / "client.key").read_bytes())
    key.chmod(0o644)
    with pytest.raises(ConfigError, match="lets others in"):
        make_client(
            settings(tls=True, client_cert=str(certificates / "client.crt"), client_key=str(key)).mqtt
        )


def test_a_key_that_needs_a_password_is_an_error_and_never_a_question(tmp_path, certificates):
    locked = tmp_path / "locked.key"
    words = ["-in", certificates / "client.key", "-aes256", "-passout", "pass:x", "-out", locked]
    subprocess.run(["openssl", "ec", *words], check=True, capture_output=True)
    locked.chmod(0o600)
    with pytest.raises(ConfigError, match=r"mqtt\.client_cert"):
        make_client(
            settings(tls=True, client_cert=str(certificates / "client.crt"), client_key=str(locked)).mqtt
        )
