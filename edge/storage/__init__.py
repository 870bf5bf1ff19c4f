"""The history: SQLite, written in a thread of its own, never waited for."""

from edge.storage.archive import Session
from edge.storage.outbox import Outbox, OutboxMessage
from edge.storage.storage import Storage

__all__ = ["Outbox", "OutboxMessage", "Session", "Storage"]
