"""The broker's end: what is not acknowledged comes again, and no more than the window waits here."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from certificates import make_certificates
from fleet_store import BROKER

from edge.config.settings import MqttSettings
from edge.core.errors import ConfigError
from fleet.ingest.inbox import WINDOWS_MAX, FleetInbox, Message
from fleet.ingest.tick import PAYLOAD_MAX
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for

pytestmark = [needs_mosquitto, pytest.mark.slow]
TICK = "greenhouse/rig-1/history/tick"
WINDOW = 20


@contextmanager
def connected(settings: MqttSettings) -> Iterator[FleetInbox]:
    inbox = FleetInbox(settings, WINDOW)
    inbox.start()
    try:
        wait_for(lambda: inbox.is_connected, "a connection")
        yield inbox
    finally:
        inbox.close()


def settings(broker: Broker) -> MqttSettings:
    return MqttSettings(host="127.0.0.1", port=broker.port, rig="fleet")


def take(inbox: FleetInbox, count: int) -> list[Message]:
    """So many messages, and those that came with them."""
    found: list[Message] = []
    wait_for(lambda: found.extend(inbox.take(0.2)) or len(found) >= count, f"{count} messages")
    return found


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path, BROKER) as own:
        yield own


def test_what_waits_here_is_bounded_and_all_of_it_comes_in_order(broker: Broker) -> None:
    count = 50 * WINDOW
    with connected(settings(broker)) as inbox, Listener(broker.port, "nothing") as sender:
        for number in range(count - 1):
            sender.client.publish(TICK, str(number), qos=1)
        sender.send(TICK, str(count - 1))  # by then the broker has all
        first = take(inbox, WINDOW)
        assert len(first) == WINDOW  # nothing was acknowledged, so no more came
        heard = [message.payload.decode() for message in first]
        inbox.acknowledge(first)
        while len(heard) < count:
            found = inbox.take(1.0)
            assert len(found) <= WINDOWS_MAX * WINDOW
            heard += [message.payload.decode() for message in found]
            inbox.acknowledge(found)
        assert heard == [str(number) for number in range(count)]


def test_what_was_not_acknowledged_comes_again(broker: Broker) -> None:
    with Listener(broker.port, "nothing") as sender:
        with connected(settings(broker)) as inbox:
            for number in range(4):
                sender.send(TICK, str(number))
            inbox.acknowledge(take(inbox, 4)[:2])
        sender.send(TICK, "while it was away")
        with connected(settings(broker)) as inbox:
            found = take(inbox, 3)
            assert [message.payload for message in found] == [b"2", b"3", b"while it was away"]
            inbox.acknowledge(found)
        with connected(settings(broker)) as inbox:
            assert inbox.take(1.0) == []


def test_an_acknowledgement_of_an_earlier_connection_is_not_sent(broker: Broker) -> None:
    with connected(settings(broker)) as inbox, Listener(broker.port, "nothing") as sender:
        sender.send(TICK, "first")
        (early,) = take(inbox, 1)
        broker.kill()
        wait_for(lambda: not inbox.is_connected)
        broker.start()
        wait_for(lambda: inbox.is_connected)
        sender.wait_until_subscribed()
        sender.send(TICK, "second")  # the broker has lost the first, and numbers anew
        again = take(inbox, 1)
        inbox.acknowledge([early])
        inbox.close()
    with connected(settings(broker)) as inbox:
        assert [message.payload for message in take(inbox, 1)] == [again[-1].payload] == [b"second"]
        assert early.mid == again[-1].mid  # the same id: it would have been taken for stored


def test_a_large_payload_is_not_kept(broker: Broker) -> None:
    with connected(settings(broker)) as inbox, Listener(broker.port, "nothing") as sender:
        sender.send(TICK, b"x" * (PAYLOAD_MAX + 1))
        (found,) = take(inbox, 1)
    assert (found.payload, found.size) == (b"", PAYLOAD_MAX + 1)


def test_of_states_the_newest_is_enough(broker: Broker) -> None:
    with connected(settings(broker)) as inbox, Listener(broker.port, "nothing") as sender:
        for number in range(50):
            sender.client.publish("greenhouse/rig-1/state", str(number), qos=0)
        sender.send(TICK, "last")  # by then the broker has handed over what came before
        found = take(inbox, 2)
    assert [message.payload for message in found if message.what == "state"][-1] == b"49"
    assert len(found) <= 6  # the states of a look or two, not all


def test_a_broker_with_tls_and_a_password_lets_it_in(tmp_path: Path) -> None:
    made = make_certificates(tmp_path / "certificates")
    users, password = tmp_path / "users", tmp_path / "password"
    subprocess.run(["mosquitto_passwd", "-c", "-b", str(users), "fleet", "secret"], check=True)
    password.write_text("secret\n")
    password.chmod(0o600)
    files = f"cafile {made}/ca.crt\ncertfile {made}/broker.crt\nkeyfile {made}/broker.key"
    with Broker(tmp_path, f"allow_anonymous false\npassword_file {users}\n{files}") as broker:
        own = replace(
            settings(broker), tls=True, ca=f"{made}/ca.crt", username="fleet", password_file=str(password)
        )
        with connected(own):
            pass
        stranger = FleetInbox(replace(own, username="other"), WINDOW)
        stranger.start()
        try:
            wait_for(lambda: "not authorised" in broker.log)
            assert not stranger.is_connected
        finally:
            stranger.close()


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    wrong = MqttSettings(tls=True, ca=str(tmp_path / "nowhere"))
    with pytest.raises(ConfigError, match=r"mqtt\.ca: .*nowhere"):
        FleetInbox(wrong, WINDOW)
