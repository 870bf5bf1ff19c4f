"""A test of all channels that the command line asks for, in the page's database.

The running page does it, and not the command: its user, its credentials and its sandbox are those that count.
Imports no package of the page's, as the command runs without them, too.
"""

import json
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from edge.formats.reader import parse_json, read
from edge.page.access import Access

ASKED, ANSWERED = "alarm_trial", "alarm_trial_answer"
TRIAL_MAX_S = 60.0  # a look, and all channels at once


@dataclass(frozen=True, slots=True)
class ChannelTrial:
    """A test that somebody has asked for at `utc` [s since 1970]."""

    id: str
    utc: float


@dataclass(frozen=True, slots=True)
class TrialAnswer:
    """How it went. reasons : by channel, "" where the message arrived"""

    id: str
    reasons: Mapping[str, str]


def ask(access: Access, utc: float) -> str:
    """Ask the running page for a test; return its name. Errors: DataError"""
    trial = ChannelTrial(secrets.token_hex(8), utc)
    access.set_fact(ASKED, json.dumps(asdict(trial)))
    return trial.id


def answer_of(access: Access, name: str) -> Mapping[str, str] | None:
    """Return how a test went, None until the page says so. Errors: DataError"""
    text = access.fact(ANSWERED)
    answer = None if text is None else read(TrialAnswer, parse_json(text, ANSWERED), ANSWERED)
    return answer.reasons if answer is not None and answer.id == name else None


def take(access: Access, utc: float) -> str | None:
    """Return the name of a test that waits, once; None where there is none. Errors: DataError"""
    text = access.fact(ASKED)
    if text is None:
        return None
    access.set_fact(ASKED, None)  # first: one that cannot be read is not tried for ever
    trial = read(ChannelTrial, parse_json(text, ASKED), ASKED)
    return trial.id if abs(utc - trial.utc) <= TRIAL_MAX_S else None  # else nobody waits for it any more


def answer(access: Access, name: str, reasons: Mapping[str, str]) -> None:
    """Leave word how a test went. Errors: DataError"""
    access.set_fact(ANSWERED, json.dumps(asdict(TrialAnswer(name, reasons))))
