"""Many rigs in one process: connections, topics and payloads of real daemons, no boards, no histories.

simulated_rigs.py PORT TEMPLATES LAGS STEP_S; on stdin, `active N` lets the first N rigs tick, and `end`
prints how many ticks each has sent. A tick is made from its number, so one that is sent again is the same.
"""

import json
import selectors
import sys
import time
import uuid
from pathlib import Path
from typing import Any, TextIO

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

PREFIX = "greenhouse"
GOLDEN = 0.6180339887  # spreads the rigs' ticks over the step, however many there are
MISC_S = 5.0  # between two looks at keep-alives
CONNECTS_PER_TURN = 20
# As edge.mqtt.telemetry has them.
LANES = (("emergency_stop", "release_emergency_stop"), ("mode", "ask"), ("maintenance",))
Template = dict[str, str]  # topic below the rig's -> payload from its third key on


class SimulatedRig:
    """One rig: four connections, as a daemon has. lags : where the broker's answers are noted"""

    def __init__(self, index: int, port: int, templates: list[Template], step_s: float, lags: TextIO) -> None:
        self.name = f"sim-{index:06}"
        self._root = f"{PREFIX}/{self.name}"
        self._index, self._templates, self._step_s, self._lags = index, templates, step_s, lags
        self._history_id = str(uuid.uuid5(uuid.NAMESPACE_DNS, self.name))
        self.sent = 0
        self._waiting: dict[int, float] = {}  # message id -> when it was sent
        now = time.time()
        self._first_utc = now + step_s * (index * GOLDEN % 1.0)
        self.clients = [self._connect(port, ""), *(self._connect(port, lane[0], lane) for lane in LANES)]

    @property
    def next_utc(self) -> float:
        """When the next tick is due."""
        return self._utc(self.sent + 1)

    def tick(self) -> None:
        """Send a tick and the live topics, as a daemon does."""
        self.sent += 1
        seq = self.sent
        self._waiting[self._send_tick(seq, is_resend=0)] = time.monotonic()
        for topic, rest in self._template(seq).items():
            if topic != "history/tick":
                payload = f'{{"seq":{seq},"utc":{self._utc(seq)},{rest}'
                self.clients[0].publish(f"{self._root}/{topic}", payload, qos=0, retain=True)

    def payload(self, seq: int, is_resend: int) -> str:
        """Return the tick's message."""
        head = f'"history_id":"{self._history_id}","seq":{seq},"is_resend":{is_resend},"utc":{self._utc(seq)}'
        return f"{{{head},{self._template(seq)['history/tick']}"

    def _send_tick(self, seq: int, is_resend: int) -> int:
        payload = self.payload(seq, is_resend)
        return self.clients[0].publish(f"{self._root}/history/tick", payload, qos=1).mid

    def _utc(self, seq: int) -> float:
        return round(self._first_utc + self._step_s * (seq - 1), 3)

    def _template(self, seq: int) -> Template:
        return self._templates[(self._index + seq) % len(self._templates)]

    def _connect(self, port: int, lane: str, commands: tuple[str, ...] = ("+",)) -> Client:
        name = f"{PREFIX}-{self.name}{lane and f'/{lane}'}"
        client = Client(CallbackAPIVersion.VERSION2, name, protocol=MQTTProtocolVersion.MQTTv5)
        client.max_inflight_messages_set(0)
        topics = [(f"{self._root}/set/{command}", 1) for command in commands]
        if not lane:
            client.will_set(f"{self._root}/availability", "offline", qos=1, retain=True)
            client.on_message, client.on_publish = self._on_message, self._on_publish

        def greet(own: Client, *_: Any) -> None:
            own.subscribe(topics)
            if not lane:
                own.publish(f"{self._root}/availability", "online", qos=1, retain=True)

        client.on_connect = greet
        client.connect("127.0.0.1", port, keepalive=30 if not lane else 10)
        return client

    def _on_publish(self, client: Client, _: object, mid: int, *__: object) -> None:
        began_s = self._waiting.pop(mid, None)
        if began_s is not None:
            self._lags.write(f"{time.time():.3f} {time.monotonic() - began_s:.4f}\n")

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        if message.topic.endswith("/set/resend"):
            asked = json.loads(message.payload)
            seqs = range(max(1, asked["first_seq"]), min(self.sent, asked["last_seq"]) + 1)
            reply = {"command": "resend", "ok": True, "queued": len(seqs), **asked}
            client.publish(f"{self._root}/reply", json.dumps(reply), qos=1)
            for seq in seqs:
                self._send_tick(seq, is_resend=1)


class RigField:
    """All of them, in one loop."""

    def __init__(self, port: int, templates: list[Template], step_s: float, lags: TextIO) -> None:
        self._port, self._templates, self._step_s, self._lags = port, templates, step_s, lags
        self._rigs: list[SimulatedRig] = []
        self._wanted = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(sys.stdin, selectors.EVENT_READ)
        self._misc_s = time.monotonic()

    def run(self) -> None:
        """Run until `end` is read."""
        while True:
            for key, _ in self._selector.select(0.02):
                if key.data is None:
                    words = sys.stdin.readline().split()
                    if words[:1] != ["active"]:
                        print(json.dumps({rig.name: rig.sent for rig in self._rigs}), flush=True)
                        return
                    self._wanted = int(words[1])
                else:
                    key.data.loop_read()
            self._grow()
            self._turn()

    def _grow(self) -> None:
        for index in range(len(self._rigs), min(self._wanted, len(self._rigs) + CONNECTS_PER_TURN)):
            rig = SimulatedRig(index, self._port, self._templates, self._step_s, self._lags)
            self._rigs.append(rig)
            for client in rig.clients:
                connection = client.socket()
                assert connection is not None  # it is up: `connect` has returned
                self._selector.register(connection, selectors.EVENT_READ, client)

    def _turn(self) -> None:
        now, is_due = time.time(), time.monotonic() >= self._misc_s
        for rig in self._rigs:
            if rig.next_utc <= now:
                rig.tick()
            if is_due or rig.clients[0].want_write():
                for client in rig.clients:
                    client.loop_write()
                    client.loop_misc()
        if is_due:
            self._misc_s = time.monotonic() + MISC_S
            self._lags.flush()


if __name__ == "__main__":
    given_port, given_templates, given_lags, given_step = sys.argv[1:]
    with Path(given_lags).open("w", encoding="utf-8") as lags_file:
        known = json.loads(Path(given_templates).read_text(encoding="utf-8"))
        RigField(int(given_port), known, float(given_step), lags_file).run()
