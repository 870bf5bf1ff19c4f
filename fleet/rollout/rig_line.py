"""The way to the rigs: orders out, and events back that the broker keeps until they are in the database."""

import json
import queue
from collections.abc import Callable
from typing import Protocol

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from edge.config.settings import MqttSettings
from edge.formats.reader import DocumentError, parse_json
from edge.mqtt.connection import end, make_client
from fleet.rollout.states import OFFLINE, ONLINE, News

SESSION_S = 14 * 86_400  # for which the broker keeps events while no runner is there
LANE = "rollout"
Heard = tuple[News, MQTTMessage]


class RigLine(Protocol):
    """Orders to rigs, and news of them."""

    def install(self, rig: str, url: str, sha256: str) -> bool:
        """Send an order; False where it can't be sent now."""
        ...

    def roll_back(self, rig: str, version: str) -> bool:
        """Send an order; False where it can't be sent now."""
        ...

    def hears(self) -> bool:
        """Return whether rigs can be heard now."""
        ...

    def news(self) -> list[News]:
        """Return what was heard since the last call."""
        ...

    def confirm(self) -> None:
        """Say that the news of the last call are kept."""
        ...


class MqttRigLine:
    """Over the broker. Errors: ConfigError for settings of the broker that waiting cannot mend

    wake : called by the network's thread when news came, or orders can be sent from now on
    """

    def __init__(self, settings: MqttSettings, wake: Callable[[], None] = lambda: None) -> None:
        self._prefix, self._wake = settings.topic_prefix, wake
        self._can_hear = False  # no order before its answer can be heard
        self._waiting: queue.SimpleQueue[Heard] = queue.SimpleQueue()
        self._unconfirmed: list[Heard] = []
        self._client = make_client(settings, lane=LANE)
        # A message is acknowledged once it is in the database: after a kill the next runner gets it.
        self._client.manual_ack_set(True)
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho has no type here
        session.SessionExpiryInterval = SESSION_S
        self._client.connect_async(
            settings.host, settings.port, settings.keepalive_s, clean_start=False, properties=session
        )
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.loop_start()

    def close(self) -> None:
        """Disconnect and end the thread; the broker keeps what comes from now on."""
        end(self._client)

    def install(self, rig: str, url: str, sha256: str) -> bool:
        """Order a rig to install a bundle."""
        return self._send(f"{rig}/set/install_bundle", {"url": url, "sha256": sha256})

    def roll_back(self, rig: str, version: str) -> bool:
        """Order a rig to leave a bundle."""
        return self._send(f"{rig}/set/rollback_bundle", {"version": version})

    def hears(self) -> bool:
        """Return whether rigs can be heard now."""
        return self._can_hear

    def news(self) -> list[News]:
        """Return what was heard since the last call."""
        while not self._waiting.empty():
            self._unconfirmed.append(self._waiting.get())
        return [news for news, _ in self._unconfirmed]

    def confirm(self) -> None:
        """Let the broker forget the news of the last call."""
        for _, message in self._unconfirmed:
            if message.qos:
                self._client.ack(message.mid, message.qos)
        self._unconfirmed.clear()

    def _send(self, topic: str, order: dict[str, str]) -> bool:
        if not self._can_hear:
            return False
        self._client.publish(f"{self._prefix}/{topic}", json.dumps(order), qos=1)
        return True

    def _on_connect(self, client: Client, _: object, flags: object, code: ReasonCode, more: object) -> None:
        if not code.is_failure:
            client.subscribe([(f"{self._prefix}/+/event", 1), (f"{self._prefix}/+/availability", 1)])

    def _on_subscribe(
        self, client: Client, _: object, mid: int, codes: list[ReasonCode], more: object
    ) -> None:
        self._can_hear = not any(code.is_failure for code in codes)
        self._wake()

    def _on_disconnect(self, *_: object) -> None:
        self._can_hear = False

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        news = read_news(message.topic, bytes(message.payload))
        if news is not None:
            self._waiting.put((news, message))
            self._wake()
        elif message.qos:
            client.ack(message.mid, message.qos)


def read_news(topic: str, payload: bytes) -> News | None:
    """Return the news in a message, None where it holds none that can be understood."""
    _, rig, kind = topic.split("/")
    if kind == "availability":
        word = payload.decode(errors="replace")
        return News(rig, word) if word in (ONLINE, OFFLINE) else None
    try:
        event = parse_json(payload)
    except DocumentError:
        return None
    key, text = event.get("key"), event.get("text")
    return News(rig, key, text) if isinstance(key, str) and isinstance(text, str) else None
