"""The history: SQLite, written in a thread of its own, never waited for.

Ticks as rows and back, the outbox of telemetry, retention, runs out of the history and into it, and dated
facts.
"""

from edge.storage.archive import Session
from edge.storage.facts import FactBook
from edge.storage.outbox import Outbox, OutboxMessage
from edge.storage.storage import Storage

__all__ = ["FactBook", "Outbox", "OutboxMessage", "Session", "Storage"]
