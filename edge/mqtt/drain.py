"""Store and forward: empties the outbox in order, forgetting a row only when the broker has it.

At least once: a row whose PUBACK was lost is sent again. Payloads carry history id and sequence number, so a
subscriber can drop what it has and see what is missing.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from paho.mqtt.client import Client

from edge.storage import OutboxMessage

BATCH_ROWS = 500  # rows read, and forgotten, in one go
REFUSED_PAUSE_S = 30.0  # a broker that refuses (access list, quota) is asked again after this long


class MessageQueue(Protocol):
    """Rows in the order they were written, resent ones last; a row leaves by `acknowledge` alone."""

    def pending(self, limit: int) -> Sequence[OutboxMessage]:
        """Return at most `limit` messages, those in flight included."""
        ...

    def acknowledge(self, ids: Sequence[int]) -> None:
        """Delete messages that the broker has taken; unknown ids are ignored."""
        ...

    def depth(self) -> int:
        """Return the number of rows, those in flight included."""
        ...


class Drain:
    """Moves rows from the outbox to the broker, as many in flight as the broker takes.

    What is in flight when the connection breaks stays with the MQTT client, which sends it again after it has
    reconnected; so nothing here depends on the connection, and the order is kept.
    """

    def __init__(self, outbox: MessageQueue, client: Client, clock: Callable[[], float]) -> None:
        self._outbox, self._client, self._clock = outbox, client, clock
        self.window = BATCH_ROWS  # most in flight at once
        self.refusal = ""  # the broker's last word against a row; "" since it took one
        self._waiting: deque[OutboxMessage] = deque()  # read, not given to the client yet
        self._in_flight: deque[tuple[int, OutboxMessage]] = deque()  # message id, row
        self._taken: list[int] = []
        self._answers: dict[int, str] = {}  # message id -> "" or why it was refused
        self._pause_until = 0.0

    def note_answer(self, mid: int, refusal: str) -> None:
        """Note the broker's answer to the message `mid`, one of the drain's or
        not. The network thread calls this.

        paho's own MQTTMessageInfo can't be asked: for a message queued without a connection it raises, even
        long after the message has been sent.
        """
        self._answers[mid] = refusal

    def step(self) -> bool:
        """Do what can be done without waiting. Returns whether rows are in flight."""
        self._collect()
        if not self._waiting and not self._in_flight:
            self._forget()
            if self._clock() < self._pause_until:
                return False
            self._answers.clear()  # of others; message ids come round again
            self._waiting.extend(self._outbox.pending(BATCH_ROWS))
        while self._waiting and len(self._in_flight) < self.window:
            row = self._waiting.popleft()
            self._in_flight.append((self._client.publish(row.topic, row.payload, qos=1).mid, row))
        return bool(self._in_flight)

    def _collect(self) -> None:
        """Take off the front what the broker has answered."""
        while self._in_flight and self._in_flight[0][0] in self._answers:
            mid, row = self._in_flight.popleft()
            refusal = self._answers.pop(mid)
            if refusal:
                self.refusal = refusal
                self._pause_until = self._clock() + REFUSED_PAUSE_S
            else:
                self._taken.append(row.id)

    def _forget(self) -> None:
        if self._taken:
            self._outbox.acknowledge(self._taken)
            self._taken = []
            if not self._clock() < self._pause_until:
                self.refusal = ""
