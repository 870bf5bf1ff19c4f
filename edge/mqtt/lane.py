"""A connection to the broker of its own for orders that must not wait: emergency stop, maintenance.

A broker queues messages for each client. Behind a flood of other commands that queue is long, and a full one
loses a stop; the queue of a client that subscribes to nothing but stops is empty.
"""

import threading
from collections.abc import Callable
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode

from edge.config.settings import Settings
from edge.mqtt.connection import make_client
from edge.mqtt.topics import Topics

Hear = Callable[[str, bytes], None]


class Lane:
    """Hears some commands, from the moment at which the broker has granted all of them.

    commands : names of topics `set/<name>`
    hear : called by the connection's thread with name and payload; never waits
    """

    def __init__(self, settings: Settings, commands: tuple[str, ...], hear: Hear) -> None:
        topics = Topics.of(settings.mqtt)
        self.commands = commands
        self.is_open = False
        self._hear = hear
        self._subscriptions = [(topics.command(what), 1) for what in commands]
        self._client = make_client(settings.mqtt, lane=commands[0])
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.loop_start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Disconnect and end the thread."""
        end(self._client, timeout_s)

    def _on_connect(self, client: Client, _: object, flags: object, code: ReasonCode, more: object) -> None:
        if not code.is_failure:
            client.subscribe(self._subscriptions)

    def _on_subscribe(
        self, client: Client, _: object, mid: int, codes: list[ReasonCode], more: object
    ) -> None:
        self.is_open = not any(code.is_failure for code in codes)

    def _on_disconnect(self, *_: Any) -> None:
        self.is_open = False

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        if not message.retain:  # an old order, from before this connection, must not act
            self._hear(message.topic.rpartition("/")[2], bytes(message.payload))


def end(client: Client, timeout_s: float = 2.0) -> None:
    """Disconnect; the network thread may stand in a name look-up, which nothing can cut short."""
    client.disconnect()
    stopping = threading.Thread(target=client.loop_stop, daemon=True)
    stopping.start()
    stopping.join(timeout_s)
