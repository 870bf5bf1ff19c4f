"""Who answers which request. What needs the disk or a language model never comes to the control thread."""

import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Protocol

from edge.app.nightly_diagnosis import NightlyDiagnosis
from edge.assistant.requests.desk import WishDesk
from edge.assistant.why.ask_history import why
from edge.bundle.keeper import BundleKeeper
from edge.config.settings import Settings
from edge.core.errors import GreenhouseError
from edge.formats.cross_check import Rule
from edge.mqtt.commands import Resend
from edge.mqtt.topics import Topics
from edge.storage import Outbox
from edge.tick.inbox import Inbox, Reply, Request
from edge.tick.orders import read_request
from edge.tick.reference import zone_of

ASKED_OF_THE_DESK = ("ask", "proposal", "confirm", "discard", "undo", "memory", "remember", "forget")
ShowState = Callable[[Mapping[str, str]], None]  # publishes how far commissioning is
UTC_MAX = 253_402_300_799.0  # the last second of the year 9999, the calendar's end [s since 1970]


@dataclass(frozen=True, slots=True)
class WhyRequest:
    """Keys of the request for the reasons of a command; null is the newest."""

    at_utc: Annotated[float, Rule(low=0.0, high=UTC_MAX)] | None = None


class Commissioning(Protocol):
    """Commissioning by the service itself, which outlives its daemons."""

    def answer(self, request: Request, status: Callable[[], Reply]) -> Reply:
        """Begin or end the tests, or say why not. status : asks the control loop. Never raises"""
        ...

    def serve(self, stop_daemon: Callable[[], None], show: ShowState | None) -> None:
        """Take a new daemon's way to its end, and where its telemetry wants to see the state."""
        ...

    def signal(self) -> None:
        """Note that the whole service ends."""
        ...


@dataclass(frozen=True, slots=True)
class Routes:
    """Called from the threads of the control socket and of MQTT."""

    settings: Settings
    inbox: Inbox
    bundles: BundleKeeper | None
    desk: WishDesk
    commissioning: Commissioning | None = None
    nightly: NightlyDiagnosis | None = None

    def ask(self, request: Request) -> Reply:
        """Return the answer; never raises."""
        try:
            match request.get("do"):
                case "resend":
                    return resend(self.settings, read_request(Resend, request))
                case "why":
                    at_utc = read_request(WhyRequest, request).at_utc
                    zone = zone_of(self.settings.timezone)
                    return {"ok": True, **why(self.settings.history.path, at_utc, zone)}
                case "bundle":
                    return self.bundles.answer(request) if self.bundles else _no_bundles()
                case "adopt":
                    return self.nightly.answer(request) if self.nightly else _no_bundles()
                case "commission" if self.commissioning is not None:
                    return self.commissioning.answer(request, lambda: self.inbox.ask({"do": "status"}))
                case "commission":
                    return {"ok": False, "error": "only the service commissions: `greenhouse run`"}
                case what if what in ASKED_OF_THE_DESK:
                    return self.desk.answer(request)
        except GreenhouseError as error:
            return {"ok": False, "error": str(error)}
        return self.inbox.ask(request)


def resend(settings: Settings, span: Resend) -> Reply:
    """Queue recorded ticks again, from `first_seq` to `last_seq`; the answer names them too.

    "queued" counts the messages of this span that wait now, also those of an earlier request. A
    subscriber finds the answer to its request by the numbers. Errors: RequestError
    """
    outbox = outbox_of(settings)
    try:
        queued = outbox.resend(span.first_seq, span.last_seq)
        return {"ok": True, "queued": queued, "first_seq": span.first_seq, "last_seq": span.last_seq}
    except sqlite3.Error as error:
        return {"ok": False, "error": str(error)}
    finally:
        outbox.close()


def outbox_of(settings: Settings) -> Outbox:
    """Messages that wait for the broker."""
    return Outbox(settings.history.path, Topics.of(settings.mqtt).root)


def _no_bundles() -> Reply:
    return {"ok": False, "error": "bundle.path is empty: this rig uses no bundles"}
