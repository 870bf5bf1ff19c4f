"""Who answers which request. What needs the disk or a language model never comes to the control thread."""

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

from edge.assistant.requests.desk import WishDesk
from edge.assistant.why.ask_history import why
from edge.bundle.keeper import BundleKeeper
from edge.config.settings import Settings
from edge.core.errors import GreenhouseError, RequestError
from edge.core.plain_text import shown
from edge.mqtt.commands import SEQ_MAX
from edge.mqtt.topics import Topics
from edge.storage import Outbox
from edge.tick.inbox import Inbox, Reply, Request
from edge.tick.orders import refuse_unknown_keys
from edge.tick.reference import zone_of

ASKED_OF_THE_DESK = ("ask", "proposal", "confirm", "undo")
KEYS = {  # of the requests that are answered here
    "resend": ("first_seq", "last_seq"),
    "why": ("at_utc",),
    "bundle": ("action", "version", "job"),
    "ask": ("words",),
    "proposal": ("id",),
    "confirm": ("id",),
    "undo": (),
}
UTC_MAX = 253_402_300_799.0  # the last second of the year 9999, the calendar's end [s since 1970]


@dataclass(frozen=True, slots=True)
class Routes:
    """Called from the threads of the control socket and of MQTT."""

    settings: Settings
    inbox: Inbox
    bundles: BundleKeeper | None
    desk: WishDesk

    def ask(self, request: Request) -> Reply:
        """Return the answer; never raises."""
        what = request.get("do")
        if isinstance(what, str) and what in KEYS:
            try:
                refuse_unknown_keys(request, KEYS[what])
            except RequestError as error:
                return {"ok": False, "error": str(error)}
        match what:
            case "resend":
                return resend(self.settings, request)
            case "why":
                return self._why(request.get("at_utc"))
            case "bundle":
                return self.bundles.answer(request) if self.bundles else _no_bundles()
            case _ if what in ASKED_OF_THE_DESK:
                return self.desk.answer(request)
        return self.inbox.ask(request)

    def _why(self, at_utc: object) -> Reply:
        if at_utc is not None and not _is_utc(at_utc):
            return {"ok": False, "error": f"at_utc: {shown(at_utc)} is no time in seconds since 1970"}
        try:
            return {"ok": True, **why(self.settings.history.path, at_utc, zone_of(self.settings.timezone))}
        except GreenhouseError as error:
            return {"ok": False, "error": str(error)}


def resend(settings: Settings, request: Mapping[str, Any]) -> Reply:
    """Queue recorded ticks again, from `first_seq` to `last_seq`."""
    first, last = request.get("first_seq"), request.get("last_seq")
    if not _is_seq(first) or not _is_seq(last) or not first <= last:
        return {
            "ok": False,
            "error": f"first_seq {shown(first)}, last_seq {shown(last)}: not a span of sequence numbers",
        }
    outbox = outbox_of(settings)
    try:
        return {"ok": True, "queued": outbox.resend(first, last)}
    except sqlite3.Error as error:
        return {"ok": False, "error": str(error)}
    finally:
        outbox.close()


def outbox_of(settings: Settings) -> Outbox:
    """Messages that wait for the broker."""
    return Outbox(settings.history.path, Topics.of(settings.mqtt).root)


def _no_bundles() -> Reply:
    return {"ok": False, "error": "bundle.path is empty: this rig uses no bundles"}


def _is_utc(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= UTC_MAX


def _is_seq(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= SEQ_MAX
