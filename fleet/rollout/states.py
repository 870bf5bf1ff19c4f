"""States of rollouts, waves and rigs, what news does to a rig, and when a rig counts as unhealthy. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from edge.bundle import remote
from fleet.database.tables import RolloutRig


class RolloutState(StrEnum):
    """State of a rollout; one that is stopped may still have rigs to roll back."""

    RUNNING = "running"
    DONE = "done"
    STOPPED = "stopped"


class WaveState(StrEnum):
    """State of a wave."""

    INSTALLING = "installing"
    JUDGING = "judging"
    HELD = "held"  # its time is over and nothing is shown: judged on, until a person lets it go on
    PASSED = "passed"
    STOPPED = "stopped"


class RigState(StrEnum):
    """State of a rig within a rollout."""

    ORDERED = "ordered"
    ACTIVE = "active"
    REFUSED = "refused"
    CHANGED = "changed"  # a person at the rig has chosen another bundle since
    ROLLING_BACK = "rolling back"
    ROLLED_BACK = "rolled back"


ONLINE, OFFLINE = "online", "offline"  # news that is not an event
AT_ONCE = ("bundle.refused", "bundle.rollback")  # the rig itself has left the bundle
LASTING = ("controller.raised", "controller.not_a_number", "controller.late", "fallback.failed")
ELSEWHERE = ("bundle.activate", "bundle.undo-adoption")
ANSWER_MAX_S = 3600.0  # from the order to the answer: 32 MB over a slow line, and the proof
OFFLINE_MAX_S = 1800.0  # a router that restarts is no sign
FAULT_MAX_S = 900.0  # a controller may fail at a step or two
UNHEALTHY_SHARE = 0.02  # of all rigs of a rollout: so many fail by themselves; any of less than 50 counts
OPEN = (RigState.ORDERED, RigState.ACTIVE)


@dataclass(frozen=True, slots=True)
class News:
    """Something heard of a rig. what : key of an event, ONLINE or OFFLINE; text : of the event"""

    rig: str
    what: str
    text: str = ""


def take_news(row: RolloutRig, news: News, sha256: str, version: str, utc: float) -> None:
    """Change the row of a rig by what was heard of it. sha256, version : of the rollout's bundle"""
    if news.what in (ONLINE, OFFLINE):
        if news.what == OFFLINE:
            row.offline_utc = row.offline_utc or utc
        else:
            row.offline_utc, row.sent_utc = None, 0.0  # an order may have been lost with the connection
    elif row.state == RigState.ORDERED:
        _take_answer(row, news, sha256, utc)
    elif row.state == RigState.ROLLING_BACK:
        if news.what == f"bundle.{remote.ROLL_BACK}" and news.text.startswith(f"bundle {version},"):
            row.state, row.since_utc = RigState.ROLLED_BACK, utc
        elif news.what == "bundle.failed" and f"(bundle {version}," in news.text:
            row.why = news.text
    elif row.state == RigState.ACTIVE:
        _take_event(row, news, utc)


def _take_answer(row: RolloutRig, news: News, sha256: str, utc: float) -> None:
    if news.what == f"bundle.{remote.INSTALL}" and news.text.startswith(f"sha256 {sha256},"):
        row.state, row.since_utc, row.why = RigState.ACTIVE, utc, ""
    elif news.what == "bundle.failed" and f"(sha256 {sha256}," in news.text:
        row.why = news.text
        # What could not be fetched says nothing of the bundle; the order comes again until its time is over.
        if "): http" not in news.text:
            row.state, row.since_utc = RigState.REFUSED, utc


def _take_event(row: RolloutRig, news: News, utc: float) -> None:
    if news.what in ELSEWHERE:
        row.state, row.since_utc, row.why = RigState.CHANGED, utc, news.text
    elif news.what in (*AT_ONCE, *LASTING) and row.fault not in AT_ONCE:
        row.fault, row.fault_utc, row.why = news.what, utc, news.text
    elif news.what == f"{row.fault}.over" and row.fault not in AT_ONCE:
        row.fault, row.fault_utc, row.why = "", None, ""


def complaint(row: RolloutRig, utc: float, hearing_utc: float = 0.0) -> str:
    """Return why a rig counts as unhealthy, "" if it does not.

    hearing_utc : since when rigs are heard without a gap: what lasted while nobody listened may be over
    """

    def lasted_s(since_utc: float) -> float:
        return utc - max(since_utc, hearing_utc)

    if row.state == RigState.REFUSED:
        return f"refused: {row.why}"
    if row.state not in OPEN:
        return ""
    if row.offline_utc is not None and lasted_s(row.offline_utc) > OFFLINE_MAX_S:
        return "offline"
    if row.state == RigState.ORDERED and lasted_s(row.since_utc) > ANSWER_MAX_S:
        return f"has not obeyed within {ANSWER_MAX_S / 60.0:g} min{f': {row.why}' if row.why else ''}"
    if row.fault in AT_ONCE or (row.fault_utc is not None and lasted_s(row.fault_utc) > FAULT_MAX_S):
        return f"{row.fault}: {row.why}"
    return ""


def harm(rows: Sequence[RolloutRig], utc: float, hearing_utc: float = 0.0) -> str:
    """Return why unhealthy rigs stop a rollout, "" where they are no more than fail by themselves."""
    found = {row.rig: said for row in rows if (said := complaint(row, utc, hearing_utc))}
    if len(found) <= int(UNHEALTHY_SHARE * len(rows)):
        return ""
    rig, said = next(iter(sorted(found.items())))
    return f"{len(found)} of {len(rows)} rigs are unhealthy; {rig}: {said}"
