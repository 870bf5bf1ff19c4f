"""The paho client, set up from the settings: session, last will, TLS, user; and the connections
for orders that must not wait: emergency stop, words that may mean it, and maintenance.

Orders that must not wait have a client of their own: a broker queues messages for each client. Behind a flood
of other commands that queue is long, and a full one loses a stop; the queue of a client that subscribes to
nothing but stops is empty.
"""

import ssl
import threading
import time
from collections.abc import Callable
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode

from edge.config.secrets import read_secret, secret_path
from edge.config.settings import MqttSettings, Settings
from edge.core.errors import ConfigError
from edge.mqtt.topics import Topics

RECONNECT_MIN_S = 1
RECONNECT_MAX_S = 60
TAKEN_OVER = 0x8E  # MQTT 5's reason: another client has connected with the same client id
TAKEN_OVER_RETRY_S = 60  # two clients that evict each other spare the broker, and each is heard in turn
TAKEN_OVER_S = 5.0 * TAKEN_OVER_RETRY_S  # without an eviction, the name is this rig's alone
NO_REASON = 0x80  # paho's code for a connection that was closed without a DISCONNECT
YOUNG_S = 5.0  # longest session that counts; two clients that evict each other connect again after a second
YOUNG_SESSIONS = 3  # so many in succession are more than a broker that restarts
LANE_MAX_S = 10  # between two tries, and between two signs of life, of a connection for stops
CONNECT_TIMEOUT_S = 5.0


def make_client(settings: MqttSettings, lane: str = "") -> Client:
    """Return a client that is not connected yet. Errors: ConfigError for a fault that waiting cannot mend

    lane : name of a connection beside the main one, which alone speaks for the rig by its last will
    """
    topics = Topics.of(settings)
    # MQTT 5 because only there a broker says that it refused a message; 3.1.1 acknowledges and drops it.
    # A clean session, so that no command given while this rig was away is waiting for it.
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=f"{settings.topic_prefix}-{settings.rig}{lane and f'/{lane}'}",
        protocol=MQTTProtocolVersion.MQTTv5,
    )
    if not lane:
        client.will_set(topics.availability, "offline", qos=1, retain=True)
    client.reconnect_delay_set(RECONNECT_MIN_S, LANE_MAX_S if lane else RECONNECT_MAX_S)
    client.connect_timeout = CONNECT_TIMEOUT_S
    client.max_inflight_messages_set(0)  # the drain keeps its own window
    identify(client, settings)
    keepalive_s = min(settings.keepalive_s, LANE_MAX_S) if lane else settings.keepalive_s
    client.connect_async(settings.host, settings.port, keepalive_s, clean_start=True)
    return client


def identify(client: Client, settings: MqttSettings) -> None:
    """Set user, password and TLS. Errors: ConfigError"""
    if settings.username:
        password = None
        if settings.password_file:
            password = read_secret(settings.password_file, "mqtt.password_file").value
        client.username_pw_set(settings.username, password)
    if settings.tls:
        client.tls_set_context(tls_context(settings))


def tls_context(settings: MqttSettings) -> ssl.SSLContext:
    """Return the TLS context with authority and client certificate as configured. Errors: ConfigError"""
    try:
        context = ssl.create_default_context(cafile=settings.ca or None)
    except OSError as error:
        raise ConfigError(f"mqtt.ca: {settings.ca}: {error.strerror or error}") from None
    if settings.client_cert:
        key = secret_path(settings.client_key, "mqtt.client_key")
        try:
            # Without a password OpenSSL would ask the terminal for that of an encrypted key, and wait.
            context.load_cert_chain(settings.client_cert, key, password="")
        except OSError as error:
            raise ConfigError(
                f"mqtt.client_cert: {settings.client_cert} with {key}: {error.strerror or error}"
            ) from None
    return context


class NameWatch:
    """Recognise that another client with the same client id evicts this one.

    Mosquitto 2.0.11 (Debian 12) closes a session that was taken over without a reason. There, some young
    sessions in succession raise a suspicion; an attempt to connect that fails ends it.
    """

    def __init__(self) -> None:
        self._begin_s: float | None = None  # of the session; None while there is none
        self._young = 0  # sessions in succession
        self._cause, self._evicted_s = "", float("-inf")

    def cause(self, now_s: float) -> str:
        """Return what shows that another client uses the name, "" TAKEN_OVER_S after the last eviction."""
        return self._cause if now_s - self._evicted_s < TAKEN_OVER_S else ""

    def begin(self, now_s: float) -> None:
        """Note that the broker has accepted the connection."""
        self._begin_s = now_s

    def fail(self) -> None:
        """Note that an attempt to connect has failed: the broker or the network is at fault."""
        self._young = 0
        self._evicted_s = float("-inf")

    def end(self, client: Client, code: ReasonCode, now_s: float) -> None:
        """Note the end of a session. After an eviction the client waits long before it connects again."""
        begin_s, self._begin_s = self._begin_s, None
        if code.value == TAKEN_OVER:
            self._cause = "the broker reports that its session was taken over"
        elif code.value != NO_REASON or begin_s is None:
            self._young = 0
            return
        elif not self.cause(now_s):  # with slow retries the sessions last longer
            age_s = now_s - begin_s
            # Of two rigs one suspects first. Its slow retries then end each session of the other one.
            is_young = age_s <= YOUNG_S or 0.0 <= age_s - TAKEN_OVER_RETRY_S <= YOUNG_S
            self._young = self._young + 1 if is_young else 0
            if self._young < YOUNG_SESSIONS:
                return
            self._cause = (
                f"does another client use it? sessions end after {age_s:.1f} s, the broker gives no reason"
            )
        self._evicted_s = now_s
        client.reconnect_delay_set(TAKEN_OVER_RETRY_S, 10 * TAKEN_OVER_RETRY_S)


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
        self._name = NameWatch()
        self._client = make_client(settings.mqtt, lane=commands[0])
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = lambda *_: self._name.fail()
        self._client.on_subscribe = self._on_subscribe
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.loop_start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Disconnect and end the thread."""
        end(self._client, timeout_s)

    def _on_connect(self, client: Client, _: object, flags: object, code: ReasonCode, more: object) -> None:
        if not code.is_failure:
            self._name.begin(time.monotonic())
            client.reconnect_delay_set(RECONNECT_MIN_S, LANE_MAX_S)
            client.subscribe(self._subscriptions)

    def _on_subscribe(
        self, client: Client, _: object, mid: int, codes: list[ReasonCode], more: object
    ) -> None:
        self.is_open = not any(code.is_failure for code in codes)

    def _on_disconnect(self, client: Client, _: object, flags: object, code: ReasonCode, more: Any) -> None:
        self.is_open = False
        self._name.end(client, code, time.monotonic())

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        if not message.retain:  # an old order, from before this connection, must not act
            self._hear(message.topic.rpartition("/")[2], bytes(message.payload))


def end(client: Client, timeout_s: float = 2.0) -> None:
    """Disconnect; the network thread may stand in a name look-up, which nothing can cut short."""
    client.disconnect()
    stopping = threading.Thread(target=client.loop_stop, daemon=True)
    stopping.start()
    stopping.join(timeout_s)
