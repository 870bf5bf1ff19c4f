"""A real mosquitto on a free loopback port, for tests."""

import json
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, Self

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
# Lines of mosquitto.conf for a broker that forgets nothing when it is restarted in good order.
KEEPS_SESSIONS = "allow_anonymous true\npersistence true\nmax_queued_messages 0"
PATIENCE_S = 40.0  # a wait in a test ends when what it waits for happens; this is only for when it never does


def wait_for(condition: Any, what: str = "", patience_s: float = PATIENCE_S) -> None:
    """Return once `condition()` holds."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"never happened: {what or condition}"
        time.sleep(0.01)


class Broker:
    """`with Broker(tmp_path, "allow_anonymous true") as broker:`; `extra` is lines of mosquitto.conf."""

    def __init__(self, folder: Path, extra: str = "allow_anonymous true", is_verbose: bool = True) -> None:
        self.port = free_port()
        self._folder = folder
        self._config = folder / "mosquitto.conf"
        # Started as root it would become a user who can't read the test's files.
        self._config.write_text(
            f"user root\npersistence_location {folder}/\nlistener {self.port} 127.0.0.1\n{extra}\n"
        )
        self._verbose = ["-v"] if is_verbose else []  # a line for each message
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start, and wait until it listens."""
        assert MOSQUITTO is not None
        with (self._folder / "mosquitto.log").open("ab") as log:
            self.process = subprocess.Popen(
                [MOSQUITTO, "-c", str(self._config), *self._verbose], stdout=log, stderr=log
            )
        wait_for(self._listens, f"mosquitto listens, see {self._folder}/mosquitto.log")

    def stop(self) -> None:
        """End in good order."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(PATIENCE_S)
            self.process = None

    def kill(self) -> None:
        """kill -9: whatever it held in memory is gone."""
        assert self.process is not None
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self.process = None

    @property
    def log(self) -> str:
        """The broker's output so far."""
        return (self._folder / "mosquitto.log").read_text(errors="replace")

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


class Listener:
    """A subscriber that keeps all it hears, and can publish. Use as a context manager."""

    def __init__(
        self,
        port: int,
        topic: str = "#",
        user: str = "",
        password: str = "",
        context: Any = None,
        name: str = "listener",
    ) -> None:
        self.heard: list[MQTTMessage] = []
        self._subscribed = threading.Event()
        self._topic = topic
        self.client = Client(CallbackAPIVersion.VERSION2, name, protocol=MQTTProtocolVersion.MQTTv5)
        self.client.reconnect_delay_set(1, 1)
        if user:
            self.client.username_pw_set(user, password)
        if context is not None:
            self.client.tls_set_context(context)
        self.client.on_connect = lambda client, *_: client.subscribe(self._topic, qos=1)
        self.client.on_subscribe = lambda *_: self._subscribed.set()
        self.client.on_disconnect = lambda *_: self._subscribed.clear()
        self.client.on_message = lambda client, data, message: self.heard.append(message)
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho has no type here
        session.SessionExpiryInterval = 600  # a broker that keeps sessions keeps ours while it restarts [s]
        self.client.connect_async("127.0.0.1", port, clean_start=False, properties=session)

    def __enter__(self) -> Self:
        self.client.loop_start()
        self.wait_until_subscribed()
        return self

    def __exit__(self, *_: object) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def wait_until_subscribed(self) -> None:
        """After a restart of the broker, too."""
        assert self._subscribed.wait(PATIENCE_S), "never subscribed"

    def payloads(self, topic: str) -> list[bytes]:
        """All payloads heard on `topic`, in order."""
        return [bytes(message.payload) for message in list(self.heard) if message.topic == topic]

    def objects(self, topic: str) -> list[Any]:
        """Return the messages of a topic as JSON values."""
        return [json.loads(payload) for payload in self.payloads(topic) if payload]

    def send(self, topic: str, payload: str | bytes, retain: bool = False) -> None:
        """Publish with QoS 1 and wait for the broker's acknowledgement."""
        self.client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(PATIENCE_S)


def free_port() -> int:
    """Return a port of the loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
