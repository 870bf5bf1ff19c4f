"""Orders to rigs by their own MQTT topics, and their answers. The rig's own safety still decides."""

import asyncio
import json
from collections import defaultdict, deque
from dataclasses import replace
from http import HTTPStatus
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode

from edge.config.settings import MqttSettings, ReferenceSettings
from edge.core import hard_limits as hard
from edge.core.errors import RequestError
from edge.formats.reader import DocumentError, parse_json
from edge.mqtt.commands import PAYLOAD_MAX, parse
from edge.mqtt.connection import end, make_client
from edge.mqtt.topics import Topics
from edge.page.access import NEEDS, Role
from edge.page.answers import NotAllowed

Json = dict[str, Any]

LANE = "page"  # of the fleet's client id, which `ingest` has without one
ANSWER_MAX_S = 12.0
MESSAGE_MAX = 64 << 10  # bytes, of a rig's message
DRIFTS_MAX = 200_000  # rigs
NEEDS_OF_FLEET = {"status": Role.VIEW, "why": Role.VIEW} | NEEDS  # what is not here needs an admin
# A rig has limits of its own within these.
WIDEST = ReferenceSettings(min_c=hard.REFERENCE_MIN_C, max_c=hard.REFERENCE_MAX_C)
NO_ANSWER = (
    f"no answer within {ANSWER_MAX_S:g} s. An order is not kept for a rig that is away; whether this one has "
    "acted, its state will show."
)


class OrderDesk:
    """A connection to the broker. Create it within the event loop that asks it.

    drifts : by rig, the newest verdict of its drift monitor
    """

    def __init__(self, settings: MqttSettings) -> None:
        self.drifts: dict[str, Json] = {}
        self.is_connected = False
        self._prefix = settings.topic_prefix
        self._place = f"{settings.host}:{settings.port}"
        self._settings = settings
        self._loop = asyncio.get_running_loop()
        self._waiting: defaultdict[tuple[str, str], deque[asyncio.Future[Json]]] = defaultdict(deque)
        self._client = make_client(settings, lane=LANE)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.loop_start()

    def close(self) -> None:
        """Disconnect and end the thread."""
        end(self._client)

    async def give(self, rig: str, what: str, payload: str) -> Json:
        """Send an order and return the rig's answer. Errors: NotAllowed where none comes"""
        if not self.is_connected:
            raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, f"the broker {self._place} does not answer")
        answer: asyncio.Future[Json] = self._loop.create_future()
        waiting = self._waiting[rig, what]
        waiting.append(answer)
        topic = Topics.of(replace(self._settings, rig=rig)).command(what)
        try:
            self._client.publish(topic, payload.encode(), qos=1)
            return await asyncio.wait_for(answer, ANSWER_MAX_S)
        except TimeoutError:
            raise NotAllowed(HTTPStatus.GATEWAY_TIMEOUT, NO_ANSWER) from None
        finally:
            if answer in waiting:
                waiting.remove(answer)
            if not waiting:
                self._waiting.pop((rig, what), None)

    def _on_connect(self, client: Client, _: object, flags: object, code: ReasonCode, more: object) -> None:
        self.is_connected = not code.is_failure
        client.subscribe([(f"{self._prefix}/+/reply", 1), (f"{self._prefix}/+/drift", 0)])

    def _on_disconnect(self, *_: Any) -> None:
        self.is_connected = False

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        levels = message.topic.split("/")
        if len(levels) != 3 or len(message.payload) > MESSAGE_MAX:
            return
        try:
            values = parse_json(bytes(message.payload), message.topic)
        except DocumentError:  # a rig's own fault: its order is told that no answer came
            return
        if levels[2] == "drift" and (levels[1] in self.drifts or len(self.drifts) < DRIFTS_MAX):
            self.drifts[levels[1]] = values
        elif levels[2] == "reply":
            self._loop.call_soon_threadsafe(self._take_answer, levels[1], values)

    def _take_answer(self, rig: str, answer: Json) -> None:
        """Give an answer to the order that waits for it longest: a rig answers in order."""
        waiting = self._waiting.get((rig, str(answer.get("command"))))
        if waiting and not waiting[0].done():
            waiting.popleft().set_result(answer)


def check(what: str, payload: str, role: Role | None) -> None:
    """Check an order before it is sent. Errors: RequestError, NotAllowed"""
    request = parse(what, payload.encode(), WIDEST)
    needed = NEEDS_OF_FLEET.get(request["do"], Role.ADMIN)
    if role is None or role < needed:
        own = "none" if role is None else role.word
        raise NotAllowed(HTTPStatus.FORBIDDEN, f"{what} needs the role {needed.word}, yours is {own}")


def payload_of(value: object) -> str:
    """Return a payload as its text: a text as it is, all else as JSON. Errors: RequestError"""
    found = value if isinstance(value, str) else json.dumps(value)
    if len(found.encode(errors="replace")) > PAYLOAD_MAX:
        raise RequestError(f"payload: at most {PAYLOAD_MAX} bytes")
    return found
