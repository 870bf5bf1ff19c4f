"""The broker's end: messages of all rigs, each acknowledged only when it is said to be stored.

The session is persistent, so the broker keeps what is not acknowledged, over an end of this process too. It
hands over `window` messages and no more until some are acknowledged. A broker that does not count well
(mosquitto 2.0.11 lets two follow each acknowledgement) is read no further when twice as many wait.
"""

import sys
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from paho.mqtt.client import Client, ConnectFlags, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from edge.config.settings import MqttSettings
from edge.mqtt.connection import CONNECT_TIMEOUT_S, end, identify
from fleet.ingest.tick import PAYLOAD_MAX

SUBSCRIBED = ("availability", "state", "history/tick", "twin", "reply")  # events come with their tick
RECONNECT_MIN_S, RECONNECT_MAX_S = 1, 4
SESSION_S = 30 * 86400  # how long the broker keeps what an ingest that is away has not got
PACKET_MAX = 16 << 20  # [bytes]; the broker drops larger ones itself
WINDOWS_MAX = 2  # of messages that wait here before no more are read
WAITING_MAX = 64 << 20  # [bytes] of their payloads, likewise
QUIET_S = 0.5  # no message for so long while SMALL_WINDOW wait: the broker waits for acknowledgements
SMALL_WINDOW = 20  # messages; mosquitto's own, unless its max_inflight_messages says otherwise
NEWEST_MAX = 1_000_000  # topics of which the newest message waits
POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Message:
    """A message. rig : as its topic says; what : the topic after that; size : of the payload [bytes]

    payload : empty where it was too large to be kept; connection : number of the connection that brought it
    is_retained : the broker had kept it, so that its rig need not be there any more
    """

    rig: str
    what: str
    payload: bytes
    size: int
    mid: int
    qos: int
    connection: int
    heard_s: float
    is_retained: bool = False


class FleetInbox:
    """Holds what was heard until it is taken.

    Errors : ConfigError for a wrong file or host; a broker that is away is none
    """

    def __init__(self, settings: MqttSettings, window: int) -> None:
        self._settings, self._window = settings, window
        self._changed = threading.Condition()
        self._queue: deque[Message] = deque()  # of QoS 1, in the order of their arrival
        self._bytes = 0  # of their payloads
        self._is_closing = False
        self._newest: dict[tuple[str, str], Message] = {}  # of QoS 0: states, of which the last one counts
        self._connection = 0
        self._heard_s = 0.0  # when the last one of QoS 1 came
        self.is_connected = False
        self._client = self._make_client()

    def start(self) -> None:
        """Connect, and stay connected, in a thread of its own."""
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho has no type here
        properties.SessionExpiryInterval = SESSION_S
        properties.ReceiveMaximum = self._window
        properties.MaximumPacketSize = PACKET_MAX
        own = self._settings
        self._client.connect_async(
            own.host, own.port, own.keepalive_s, clean_start=False, properties=properties
        )
        self._client.loop_start()

    def close(self) -> None:
        """Disconnect; the broker keeps the session."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        end(self._client)

    def take(self, longest_s: float) -> list[Message]:
        """Return what was heard, after a wait for more of at most so long; nothing where nothing came."""
        deadline = time.monotonic() + longest_s
        with self._changed:
            while (left := deadline - time.monotonic()) > 0 and not self._is_ready():
                self._changed.wait(min(left, POLL_S))
            taken = [*self._newest.values(), *self._queue]
            self._newest.clear()
            self._clear()
            self._changed.notify_all()
        return taken

    def acknowledge(self, messages: Iterable[Message]) -> None:
        """Let the broker forget them; those of an earlier connection it sends again under new ids."""
        with self._changed:  # so no new connection begins in between
            for message in messages:
                if message.qos and message.connection == self._connection:
                    self._client.ack(message.mid, message.qos)

    def ask(self, rig: str, what: str, payload: str) -> None:
        """Send a command to a rig; without a connection it is dropped, for it would come too late."""
        if self.is_connected:
            self._client.publish(f"{self._settings.topic_prefix}/{rig}/set/{what}", payload, qos=1)

    def _clear(self) -> None:
        self._queue.clear()
        self._bytes = 0

    def _has_room(self) -> bool:
        is_full = len(self._queue) >= WINDOWS_MAX * self._window or self._bytes >= WAITING_MAX
        return self._is_closing or not is_full

    def _is_ready(self) -> bool:
        waiting = len(self._queue)
        is_quiet = waiting >= SMALL_WINDOW and time.monotonic() - self._heard_s >= QUIET_S
        return is_quiet or waiting >= self._window // 2

    def _make_client(self) -> Client:
        client = Client(
            CallbackAPIVersion.VERSION2,
            client_id=f"{self._settings.topic_prefix}-{self._settings.rig}/ingest",
            protocol=MQTTProtocolVersion.MQTTv5,
            manual_ack=True,
        )
        client.reconnect_delay_set(RECONNECT_MIN_S, RECONNECT_MAX_S)
        client.connect_timeout = CONNECT_TIMEOUT_S
        identify(client, self._settings)
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_pre_connect = self._on_pre_connect
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message
        return client

    # called by the network thread

    def _on_pre_connect(self, client: Client, _: object) -> None:
        """Begin a connection: acknowledgements that paho has not sent are dropped by it at this point."""
        with self._changed:
            self._connection += 1
            if len(self._queue) > self._window:  # a connection that breaks again and again fills no memory
                self._clear()

    def _on_connect(
        self, client: Client, _: object, flags: ConnectFlags, code: ReasonCode, more: Properties | None
    ) -> None:
        if code.is_failure:
            _say(f"the broker refuses the connection: {code}")
            return
        client.subscribe([(f"{self._settings.topic_prefix}/+/{what}", 1) for what in SUBSCRIBED])

    def _on_subscribe(
        self, client: Client, _: object, mid: int, codes: list[ReasonCode], more: object
    ) -> None:
        refused = [what for what, code in zip(SUBSCRIBED, codes, strict=False) if code.is_failure]
        self.is_connected = not refused
        _say(f"the broker refuses {', '.join(refused)}" if refused else "connected to the broker")

    def _on_connect_fail(self, client: Client, _: object) -> None:
        _say(f"mqtt: {self._settings.host}:{self._settings.port} can't be reached")

    def _on_disconnect(
        self, client: Client, _: object, flags: object, code: ReasonCode, more: object
    ) -> None:
        self.is_connected = False
        _say(f"disconnected from the broker: {code}")

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        _, rig, what = message.topic.split("/", 2)
        size = len(message.payload)
        payload = b"" if size > PAYLOAD_MAX else bytes(message.payload)
        now = time.monotonic()
        with self._changed:
            # Meanwhile TCP holds the broker back. One that ends a silent connection sends all of it again.
            self._changed.wait_for(self._has_room)
            heard = Message(
                rig, what, payload, size, message.mid, message.qos, self._connection, now, message.retain
            )
            if message.qos:
                self._queue.append(heard)
                self._bytes += len(payload)
                self._heard_s = now
                self._changed.notify_all()
            elif (rig, what) in self._newest or len(self._newest) < NEWEST_MAX:
                self._newest[rig, what] = heard


def _say(text: str) -> None:
    print(f"ingest: {text}", file=sys.stderr, flush=True)
