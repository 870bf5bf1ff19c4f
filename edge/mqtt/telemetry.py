"""Telemetry and remote commands over MQTT, in threads of their own: control never waits for a broker."""

import contextlib
import json
import queue
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client, ConnectFlags, MQTTMessage
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from edge.assistant.requests.desk import nothing_asked
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.core.event_log import Allowance
from edge.core.messages import Event, Severity, TickRecord
from edge.core.plain_text import plain
from edge.formats.tick_json import event_json
from edge.mqtt import connection, discovery, states
from edge.mqtt.commands import ON, STOP, WORDED, is_stop, is_stop_in_words, parse
from edge.mqtt.connection import Lane, NameWatch, end, make_client
from edge.mqtt.drain import BATCH_ROWS, Drain, MessageQueue
from edge.mqtt.topics import Topics
from edge.tick.status import LoopStatus, reply_json, status_json

Ask = Callable[[Mapping[str, Any]], dict[str, Any]]
Post = Callable[[Mapping[str, Any], Callable[[dict[str, Any]], None]], None]

POLL_S = 1.0  # how often the outbox is looked into when nothing else happens
COMMANDS_WAITING_MAX = 32
COMMANDS_PER_S = 8.0  # at length; a person's automation sends far fewer
REFUSAL_PAUSE_S = 0.001  # so a flood of 1000/s costs a tenth of a core, and the broker holds the rest
FLOOD_OVER_S = 10.0  # after the last refusal
STOP_REPEATED_S = 10.0  # a stop that the main connection hears so long after its lane is the same one
STOP_APART_S = 0.3  # between the arrivals of one stop by both connections
# A stop and its release keep their order. Topics in which a person may say "stop" share no queue with them:
# the queue of a flooded topic is as long as the flood.
LANES = ((STOP, "release_emergency_stop"), WORDED, ("maintenance",))
EVENTS_WAITING_MAX = 200  # live events while the broker is away; all of them are in the outbox too
LATE_SHARE = 0.1  # a tick that begins later than this share of a step counts as late
SHORT = (  # keys of short answers
    *("ok", "changed", "message", "error", "warning", "queued", "first_seq", "last_seq"),
    *("proposal", "lines", "commissioning"),
)
WINDOW_RESERVE = 4  # room in the broker's receive window for messages that are not the outbox's


class Telemetry:
    """A sink of tick records, and a source of requests.

    ask : answers a request, with a time limit of its own
    post : gives a request to the control thread without waiting, and a place for its answer
    open_outbox : called once, in the thread that will use it
    own_twin : file of the twin of this rig's box that runs; None while the packaged one does
    Errors : ConfigError for a wrong file or host; a broker that is away is none
    """

    def __init__(
        self,
        settings: Settings,
        ask: Ask,
        post: Post,
        open_outbox: Callable[[], MessageQueue],
        own_twin: Callable[[], Path | None] = lambda: None,
    ) -> None:
        self._settings, self._ask, self._post, self._open_outbox = settings, ask, post, open_outbox
        self._own_twin = own_twin
        self._twin_published: Path | None = None
        self._topics = Topics.of(settings.mqtt)
        self._offline = f"not connected to {settings.mqtt.host}:{settings.mqtt.port} yet"
        self._fault = ""
        self._name = NameWatch()
        self._ticks_late = 0
        self._ticks_skipped = 0
        self._status: LoopStatus | None = None  # the newest, with a tick
        self._status_published: LoopStatus | None = None
        self._greet = False
        self._events: deque[Event] = deque(maxlen=EVENTS_WAITING_MAX)
        self._commissioning: Mapping[str, Any] | None = None  # the newest
        self._commissioning_published: Mapping[str, Any] | None = None
        self._proposals: deque[Mapping[str, Any]] = deque(maxlen=COMMANDS_WAITING_MAX)
        self._proposal: Mapping[str, Any] = nothing_asked()  # the newest that was published
        self._commands: queue.Queue[tuple[str, bytes]] = queue.Queue(COMMANDS_WAITING_MAX)
        self._answers: deque[tuple[str, dict[str, Any]]] = deque(maxlen=COMMANDS_WAITING_MAX)
        self._allowance = Allowance(COMMANDS_WAITING_MAX, COMMANDS_PER_S, time.monotonic)
        self._refusals_told = 0
        self._refusals_told_s = float("-inf")
        self._stop_heard_s = float("-inf")  # by its lane
        self._stop_heard = threading.Event()
        self._closing = False
        self._wake = threading.Event()
        self._outbox: MessageQueue | None = None
        self._drain: Drain | None = None
        self._receive_maximum = BATCH_ROWS
        self._client = make_client(settings.mqtt)
        self._set_callbacks(self._client)
        self._lanes = [Lane(settings, commands, self._hear_lane) for commands in LANES]
        lane_of = {what: lane for lane in self._lanes for what in lane.commands}
        self._lane_of = {what: lane for what, lane in lane_of.items() if what not in WORDED}
        # Last of all: both threads read what stands above from their first moment on.
        self._thread = threading.Thread(target=self._run, name="telemetry", daemon=True)
        self._thread.start()
        self._client.loop_start()

    # called by the control thread: nothing here waits

    def write(self, record: TickRecord) -> None:
        """Count a tick, and take its events; its state comes by `show`."""
        self._ticks_late += record.late_s > LATE_SHARE * record.step_s
        self._ticks_skipped += record.ticks_skipped
        self._events.extend(record.events)
        self._wake.set()

    def show(self, status: LoopStatus) -> None:
        """Publish a state, as soon as there is a broker; only the newest matters."""
        if status.record is not None:
            self._status = status
            self._wake.set()

    def show_proposal(self, proposal: Mapping[str, Any]) -> None:
        """Publish the outcome of an operator's request, whoever asked. The desk's thread calls this."""
        self._proposals.append(proposal)
        self._wake.set()

    def show_commissioning(self, state: Mapping[str, Any]) -> None:
        """Publish how far commissioning is, from any thread; only the newest matters."""
        self._commissioning = state
        self._wake.set()

    def faults(self) -> Mapping[str, str]:
        """Return the present faults, by key of the failure table."""
        refusal = self._drain.refusal if self._drain else ""
        detail = self._offline or self._fault or (refusal and f"the broker refuses: {refusal}")
        faults = {"telemetry.offline": detail} if detail else {}
        if cause := self._name.cause(time.monotonic()):  # in place of an offline that comes and goes
            faults = {"telemetry.name_taken": f"the name is {self._settings.mqtt.rig}; {cause}"}
        if time.monotonic() - self._allowance.refused_s < FLOOD_OVER_S:
            faults["telemetry.flooded"] = f"{self._allowance.refused} refused so far"
        return faults

    def close(self) -> None:
        """Say `offline`, as the last will would, and end; takes a few seconds at most."""
        self._closing = True
        self._wake.set()
        self._thread.join(2.0)
        if not self._offline:
            last = self._client.publish(self._topics.availability, "offline", qos=1, retain=True)
            with contextlib.suppress(RuntimeError, ValueError):  # the connection broke at this moment
                last.wait_for_publish(1.0)
        end(self._client)
        for lane in self._lanes:
            lane.close()

    # called by the network thread: notes what happened and wakes the worker

    def _set_callbacks(self, client: Client) -> None:
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.on_message = self._on_message

    def _on_connect(
        self, client: Client, _: object, flags: ConnectFlags, code: ReasonCode, properties: Properties | None
    ) -> None:
        if code.is_failure:
            self._offline = f"the broker refuses the connection: {code}"
            return
        self._name.begin(time.monotonic())
        client.reconnect_delay_set(connection.RECONNECT_MIN_S, connection.RECONNECT_MAX_S)
        self._receive_maximum = getattr(properties, "ReceiveMaximum", BATCH_ROWS)
        client.subscribe([(self._topics.command("+"), 1), (self._topics.home_assistant_status, 1)])
        client.publish(self._topics.availability, "online", qos=1, retain=True)
        self._offline = ""
        self._greet = True
        self._wake.set()

    def _on_connect_fail(self, client: Client, _: object) -> None:
        self._name.fail()
        self._offline = f"{self._settings.mqtt.host}:{self._settings.mqtt.port} can't be reached"

    def _on_disconnect(
        self, client: Client, _: object, flags: object, code: ReasonCode, properties: Properties | None
    ) -> None:
        self._name.end(client, code, time.monotonic())
        self._offline = self._offline or f"disconnected: {code}"

    def _on_publish(
        self, client: Client, _: object, mid: int, code: ReasonCode, properties: Properties | None
    ) -> None:
        if self._drain is not None:
            self._drain.note_answer(mid, str(code) if code.is_failure else "")
        self._wake.set()

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        if message.retain:
            return  # an old order, from before this connection, must not act; what is wanted now is said now
        if message.topic == self._topics.home_assistant_status:
            self._greet = self._greet or message.payload == b"online"
        else:
            self._hear(message.topic.rpartition("/")[2], bytes(message.payload))
            return
        self._wake.set()

    def _hear(self, what: str, payload: bytes) -> None:
        """Receive a command on the main connection. A flood ends here, before
        anything is parsed or answered.
        """
        if is_stop_in_words(what, payload):
            what, payload = STOP, ON.encode()
        lane = self._lane_of.get(what)
        if lane is not None:
            stops = what == STOP and is_stop(payload)
            if not lane.is_open or (stops and not self._is_heard_by_lane()):
                self._carry_out(what, payload)
        elif self._allowance.take():
            try:
                self._commands.put_nowait((what, payload))
            except queue.Full:
                self._allowance.refuse()
            self._wake.set()
        else:
            time.sleep(REFUSAL_PAUSE_S)

    def _is_heard_by_lane(self) -> bool:
        """Return whether a stop also arrives on its own connection, which may have died unnoticed."""
        since_s = time.monotonic() - STOP_REPEATED_S
        if self._stop_heard_s < since_s:
            self._stop_heard.clear()
            self._stop_heard.wait(STOP_APART_S)
        return self._stop_heard_s >= since_s

    def _hear_lane(self, what: str, payload: bytes) -> None:
        """Receive a command on a connection of its own, whose thread calls this."""
        if what in WORDED:
            if not is_stop_in_words(what, payload):
                return  # the main connection's
            what, payload = STOP, ON.encode()
        if what == STOP and is_stop(payload):  # a release must not make the main connection drop a stop
            self._stop_heard_s = time.monotonic()
            self._stop_heard.set()
        self._carry_out(what, payload)

    def _carry_out(self, what: str, payload: bytes) -> None:
        try:
            request = parse(what, payload, self._settings.reference)
        except RequestError as error:
            if self._allowance.take():
                self._events.append(_bad_command(what, str(error)))
                self._keep_answer(what, {"ok": False, "error": str(error)})
        else:
            self._post(request, partial(self._keep_answer, what))

    def _keep_answer(self, what: str, answer: dict[str, Any]) -> None:
        """Keep an answer for the worker; in a flood of stops only the newest answers are sent."""
        self._answers.append((what, answer))
        self._wake.set()

    # the worker

    def _run(self) -> None:
        while not self._closing:
            self._wake.wait(POLL_S)
            self._wake.clear()
            try:
                self._work()
                self._fault = ""
            except sqlite3.Error as error:
                self._fault = f"the outbox can't be read: {error}"  # tried again at the next wake
            except Exception as error:  # told and gone on: a bug must not close the way to the emergency stop
                self._fault = f"internal error: {error!r}"

    def _work(self) -> None:
        self._answer_commands()
        if not self._offline:
            self._empty_outbox()
            self._publish_news()

    def _answer_commands(self) -> None:
        answers = [
            (what, reply_json(reply))
            for what, reply in (self._answers.popleft() for _ in range(len(self._answers)))
        ]
        for what, answer in answers:
            self._reply(what, _short(answer))
        if answers and answers[-1][1].get("tick"):
            self._publish_state(answers[-1][1])
        self._tell_refusals()
        while not self._commands.empty():
            what, payload = self._commands.get_nowait()
            try:
                answer = self._ask(parse(what, payload, self._settings.reference))
            except RequestError as error:
                answer = {"ok": False, "error": str(error)}
                self._events.append(_bad_command(what, str(error)))
            if answer.get("tick"):
                self._publish_state(answer)
            self._reply(what, answer if what == "status" else _short(answer))

    def _tell_refusals(self) -> None:
        """One answer a second for all that was refused since."""
        refused, now = self._allowance.refused, time.monotonic()
        if refused != self._refusals_told and now - self._refusals_told_s >= 1.0:
            error = f"busy: {refused - self._refusals_told} commands were refused, {refused} so far"
            self._refusals_told, self._refusals_told_s = refused, now
            self._reply("", {"ok": False, "error": error})

    def _publish_news(self) -> None:
        greet, status = self._greet, self._status
        if greet:
            self._publish(self._topics.discovery, discovery.device(self._settings), qos=1, retain=True)
        if status is not None and (greet or status is not self._status_published):
            self._publish_state(status_json(status))
        # What has come up meanwhile stays to be done.
        self._greet, self._status_published = self._greet and not greet, status
        commissioning = self._commissioning
        if commissioning is not None and (greet or commissioning is not self._commissioning_published):
            self._publish(self._topics.commissioning, commissioning, qos=1, retain=True)
            self._commissioning_published = commissioning
        self._publish_twin(greet)
        if greet:  # the topic is not retained: a proposal of a daemon that is no more cannot be confirmed
            self._publish(self._topics.proposal, self._proposal, qos=1)
        while self._proposals:
            proposal = self._proposals.popleft()
            self._publish(self._topics.proposal, proposal, qos=1)
            self._proposal = proposal
        while self._events:
            self._publish(self._topics.event, event_json(self._events.popleft()), qos=1)

    def _publish_twin(self, greet: bool) -> None:
        path = self._own_twin()
        if path == self._twin_published and not greet:
            return
        self._twin_published = path
        if path is None:
            self._client.publish(self._topics.twin, b"", qos=1, retain=True)
        else:
            self._publish(self._topics.twin, states.twin(path), qos=1, retain=True)

    def _publish_state(self, status: Mapping[str, Any]) -> None:
        counters: dict[str, int | None] = {
            "ticks_late": self._ticks_late,
            "ticks_skipped": self._ticks_skipped,
            "outbox_depth": self._outbox_depth(),
        }
        self._publish(self._topics.state, states.state(status, counters), retain=True)
        self._publish(self._topics.decision, states.decision(status), retain=True)
        self._publish(self._topics.forecast, states.forecast(status), retain=True)
        self._publish(self._topics.forecasts, states.forecasts(status), retain=True)
        self._publish(self._topics.skill, states.skill(status), retain=True)
        self._publish(self._topics.drift, states.drift(status), retain=True)

    def _empty_outbox(self) -> None:
        if self._outbox is None or self._drain is None:
            self._outbox = self._open_outbox()
            self._drain = Drain(self._outbox, self._client, time.monotonic)
        self._drain.window = max(1, min(BATCH_ROWS, self._receive_maximum - WINDOW_RESERVE))
        self._drain.step()

    def _outbox_depth(self) -> int | None:
        try:
            return self._outbox.depth() if self._outbox else None
        except sqlite3.Error:
            return None  # shown as unknown; the drain meets the same error and reports it

    def _reply(self, what: str, answer: Mapping[str, Any]) -> None:
        self._publish(self._topics.reply, {"command": plain(what, 40), **answer}, qos=1)

    def _publish(self, topic: str, message: Mapping[str, Any], qos: int = 0, retain: bool = False) -> None:
        payload = json.dumps(message, separators=(",", ":"), allow_nan=False)
        self._client.publish(topic, payload, qos=qos, retain=retain)


def remove(settings: Settings, timeout_s: float = 10.0) -> None:
    """Take the rig out of Home Assistant and its retained messages off the broker. Errors: RequestError."""
    topics = Topics.of(settings.mqtt)
    client = make_client(settings.mqtt, lane="remove")  # it evicts no daemon, and has no last will
    left = {client.publish(topic, b"", qos=1, retain=True).mid for topic in topics.retained}
    done = threading.Event()

    def on_publish(client: Client, _: object, mid: int, code: ReasonCode, properties: object) -> None:
        left.discard(mid)
        if not left:
            done.set()

    client.on_publish = on_publish
    client.loop_start()
    try:
        if not done.wait(timeout_s):
            raise RequestError(f"{settings.mqtt.host}: took no message within {timeout_s:g} s")
    finally:
        client.disconnect()
        client.loop_stop()


def _short(answer: Mapping[str, Any]) -> dict[str, Any]:
    return {key: answer[key] for key in SHORT if key in answer}


def _bad_command(what: str, error: str) -> Event:
    return Event("mqtt.bad_command", Severity.WARNING, f"set/{what}: {error}", time.monotonic(), time.time())
