"""Messages that wait for the broker: put there in their tick's transaction, taken away when it has them.

A row names its tick; the payload is made from the stored tick when it is asked for. So nothing is written
twice, and what is sent again long after is the same message.
"""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.core.errors import RequestError
from edge.core.messages import TickRecord
from edge.formats.tick_json import event_json, tick_json
from edge.storage.file import connect, identity
from edge.storage.tick_rows import read_ticks

BUSY_S = 5.0  # the writer holds its lock for milliseconds
RESENDS_MAX = 20_000  # messages that wait to be sent again: two weeks of 60 s; more would crowd the disk
_CHOSEN = "id IN (SELECT value FROM json_each(:ids))"
_DELETE = f"DELETE FROM outbox WHERE {_CHOSEN}"
_PENDING = "SELECT id, seq, event, is_resend FROM outbox WHERE is_resend = ? ORDER BY id LIMIT ?"
_RESEND = (
    "INSERT INTO outbox (seq, event, is_resend) SELECT seq, event, 1 FROM"
    " (SELECT seq, NULL AS event FROM ticks"
    " UNION ALL SELECT seq, number FROM events JOIN ticks USING (seq)) AS s"
    " WHERE seq BETWEEN ? AND ? AND seq > 0"
    " AND NOT EXISTS (SELECT 1 FROM outbox o WHERE o.seq = s.seq AND o.event IS s.event)"
    " ORDER BY seq, event IS NULL, event LIMIT ?"
)
_GAPS_OF_GONE = (
    "INSERT INTO gaps SELECT seq, seq, CAST(strftime('%s', 'now') AS REAL),"
    " 'deleted or damaged before it was sent'"
    f" FROM outbox WHERE event IS NULL AND NOT is_resend AND {_CHOSEN}"
)


@dataclass(frozen=True, slots=True)
class OutboxMessage:
    """One message, to be acknowledged by its id."""

    id: int
    topic: str
    payload: str  # JSON with `history_id`, `seq` and `is_resend` (0/1): what a subscriber tells duplicates by


class Outbox:
    """The messages of the history at `path`, oldest first. For one thread, on a connection of its own.

    root : begins every topic: `<root>/history/tick` and `<root>/history/event`
    Errors : sqlite3.Error from every method, while the file is locked, broken or not there; try again later
    """

    def __init__(self, path: str | Path, root: str) -> None:
        self._path = Path(path)
        self._root = root
        self._connection: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        self._history_id = ""

    def pending(self, limit: int) -> list[OutboxMessage]:
        """Up to `limit` messages, new ones before resent ones, oldest first; they stay until acknowledged.

        Rows whose tick or event is damaged, or was deleted by another hand, can't be sent: they go, and
        leave a gap.
        """
        connection = self._open()
        while True:
            rows = connection.execute(_PENDING, (0, limit)).fetchall()
            rows += connection.execute(_PENDING, (1, limit - len(rows))).fetchall()
            ticks = read_ticks(connection, {seq for _, seq, _, _ in rows})
            known = {(seq, n) for seq, tick in ticks.items() for n in (None, *range(len(tick.events)))}
            gone = [id_ for id_, seq, event, _ in rows if (seq, event) not in known]
            if not gone:
                return [self._message(id_, ticks[seq], event, resent) for id_, seq, event, resent in rows]
            self._give_up(connection, gone)

    def acknowledge(self, ids: Sequence[int]) -> None:
        """Take these away. Ids of a file that has been replaced since mean nothing in the new one."""
        if self._connection is not None and identity(self._path) == self._identity:
            self._connection.execute(_DELETE, {"ids": json.dumps(list(ids))})

    def resend(self, first_seq: int, last_seq: int) -> int:
        """Queue stored ticks, both ends included, and their events again, but none that waits already.

        Returns : how many messages of this span wait now. Errors: RequestError where not all fit; some may
        """
        connection = self._open()
        waiting = connection.execute("SELECT count(*) FROM outbox WHERE is_resend = 1").fetchone()[0]
        room = max(0, RESENDS_MAX - waiting)
        cursor = connection.execute(_RESEND, (first_seq, last_seq, room))
        of_span = "SELECT count(*) FROM outbox WHERE seq BETWEEN ? AND ? AND seq > 0"
        queued: int = connection.execute(of_span, (first_seq, last_seq)).fetchone()[0]
        if cursor.rowcount == room:
            full = f"{RESENDS_MAX} messages wait to be sent again, {queued} of them from this span"
            raise RequestError(f"{full}: ask for the rest once they have been sent")
        return queued

    def depth(self) -> int:
        """How many messages wait."""
        return int(self._open().execute("SELECT count(*) FROM outbox").fetchone()[0])

    def close(self) -> None:
        """Close the connection; the next call opens it again."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _open(self) -> sqlite3.Connection:
        """Return a connection to the file that is at the path now."""
        if self._connection is None or identity(self._path) != self._identity:
            self.close()
            if not self._path.exists():
                raise sqlite3.OperationalError(f"{self._path} is not there")  # the writer makes it
            connection = connect(self._path, BUSY_S)
            # A lost acknowledgement means a message twice, no more: that needs no sync.
            connection.execute("PRAGMA synchronous = NORMAL")
            self._history_id = connection.execute("SELECT id FROM history").fetchone()[0]
            self._connection, self._identity = connection, identity(self._path)
        return self._connection

    def _give_up(self, connection: sqlite3.Connection, ids: list[int]) -> None:
        chosen = {"ids": json.dumps(ids)}
        connection.execute("BEGIN IMMEDIATE")
        try:
            connection.execute(_GAPS_OF_GONE, chosen)
            connection.execute(_DELETE, chosen)
            connection.execute("COMMIT")
        finally:
            if connection.in_transaction:
                connection.execute("ROLLBACK")

    def _message(self, id_: int, tick: TickRecord, event: int | None, is_resend: int) -> OutboxMessage:
        head: dict[str, Any] = {"history_id": self._history_id, "seq": tick.seq, "is_resend": is_resend}
        if event is None:
            topic, body = "tick", tick_json(tick)
        else:
            topic, body = "event", {"number": event, **event_json(tick.events[event])}
        payload = json.dumps({**head, **body}, separators=(",", ":"), ensure_ascii=False)
        return OutboxMessage(id_, f"{self._root}/history/{topic}", payload)
