"""A sentence of an operator, what would be right, and how an answer compares with it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from edge.assistant.requests.answer import seconds_of_clock
from edge.storage.facts import FactKind
from edge.tick.steering import Steering, reference_of

FILE = Path(__file__).with_name("wishes.yaml")
REMEMBERED = Path(__file__).with_name("remembered.yaml")
TARGET_K = 0.11  # a reference this near is the one that was meant
ROUNDING = 1e-6  # a penalty, duty or time this far outside its range is in it


class WishEnd(Enum):
    """The end of a question to a language model."""

    SETTINGS = "settings"  # a proposal
    ASK = "ask"  # a question back
    REFUSE = "refuse"  # the answer is beyond what the rig allows, so that nothing is proposed
    NOTHING = "nothing"  # no answer in the form


@dataclass(frozen=True, slots=True)
class EarlierFact:
    """One row of `facts`. settings : those of a decision, as a model answers them; text : of a note"""

    utc: float
    kind: FactKind
    words: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    why: str = ""
    text: str = ""
    by: str = ""
    erased: bool = False


@dataclass(frozen=True, slots=True)
class Wish:
    """One row of wishes.yaml or remembered.yaml, whose heads say what the keys mean."""

    id: str
    words: str
    best: WishEnd
    also: tuple[WishEnd, ...] = ()
    at: Mapping[str, Any] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # penalties, duty, hours
    fan_off: tuple[str, ...] = ()
    fan_free: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    facts: tuple[EarlierFact, ...] = ()

    @property
    def language(self) -> str:
        """Its first two letters: en, de or no."""
        return self.id[:2]

    def verdict(self, outcome: WishEnd, steering: Steering | None, now_utc: float) -> str:
        """Return right, wrong, or for an outcome that does no harm its name."""
        allowed = outcome in (self.best, *self.also)
        if outcome is not WishEnd.SETTINGS:
            return "right" if allowed else outcome.value
        assert steering is not None
        return "right" if allowed and not self.differences(steering, now_utc) else "wrong"

    def differences(self, steering: Steering, now_utc: float) -> list[str]:
        """Return what is not as it should be, by key."""
        found = [*self._targets(steering), *self._fan(steering)]
        values = {
            "heater_penalty": steering.heater_penalty,
            "fan_penalty": steering.fan_penalty,
            "heater_max_duty": steering.heater_max_duty,
            "hours": (steering.until_utc - now_utc) / 3600.0,
        }
        for key, value in values.items():
            if key not in self.ranges:
                if value is not None and key != "hours" and key not in self.may:
                    found.append(f"{key} {value:g}, not asked for")
                continue
            least, most = self.ranges[key]
            if value is None or not least - ROUNDING <= value <= most + ROUNDING:
                found.append(f"{key} {value}, not {least:g} to {most:g}")
        return found

    def _targets(self, steering: Steering) -> list[str]:
        reference = reference_of(steering)
        if not self.at:
            return ["a reference that was not asked for"] if reference is not None else []
        if reference is None:
            return ["no reference"]
        found = []
        for clock, meant in self.at.items():
            least, most = meant if isinstance(meant, list) else (meant - TARGET_K, meant + TARGET_K)
            at = np.array([seconds_of_clock(clock)])
            target = float(reference.at(at, at)[0])
            if not least <= target <= most:
                found.append(f"{target:g} °C at {clock}")
        return found

    def _fan(self, steering: Steering) -> list[str]:
        if not (self.fan_off or self.fan_free):
            return ["a rest of the fan that was not asked for"] if steering.fan_rest else []
        runs = [clock for clock in self.fan_off if not steering.rest_left_s(seconds_of_clock(clock)) > 0.0]
        rests = [clock for clock in self.fan_free if steering.rest_left_s(seconds_of_clock(clock)) > 0.0]
        return [
            *(f"the fan may run at {clock}" for clock in runs),
            *(f"the fan rests at {clock}" for clock in rests),
        ]


def read_wishes(path: Path = FILE) -> list[Wish]:
    """Return all of them."""
    return [_wish(row) for row in yaml.safe_load(path.read_text(encoding="utf-8"))]


def hidden_values(
    steering: Steering, lines: list[str], describe: Callable[[Steering], list[str]]
) -> list[str]:
    """Return the keys whose value a confirmation text does not show.

    describe : makes the text's lines of a steering
    """
    without: Mapping[str, Any] = {
        "daily": (),
        "heater_penalty": None,
        "fan_penalty": None,
        "heater_max_duty": None,
        "fan_rest": (),
    }
    return [
        key
        for key, nothing in without.items()
        if getattr(steering, key) != nothing and describe(replace(steering, **{key: nothing})) == lines
    ]


def _wish(row: Mapping[str, Any]) -> Wish:
    given: dict[str, Any] = dict(row)
    keys = [key for key in ("heater_penalty", "fan_penalty", "heater_max_duty", "hours") if key in given]
    ranges: dict[str, tuple[float, float]] = {
        key: (float(given[key][0]), float(given.pop(key)[1])) for key in keys
    }
    given |= {key: tuple(given[key]) for key in ("fan_off", "fan_free", "may") if key in given}
    given["facts"] = tuple(map(_fact, given.get("facts", ())))
    best, also = WishEnd(given.pop("best")), tuple(map(WishEnd, given.pop("also", ())))
    return Wish(**given, best=best, also=also, ranges=ranges)


def _fact(row: Mapping[str, Any]) -> EarlierFact:
    given = dict(row)
    when = datetime.strptime(f"2026-{given.pop('when')} +0000", "%Y-%m-%d %H:%M %z")
    values: dict[str, Any] = given.pop("set", {})
    if "reference" in values:
        pairs = values["reference"].items()
        values = {**values, "reference": [{"from": clock, "degc": degc} for clock, degc in pairs]}
    if "fan_rest" in values:
        pairs = values["fan_rest"].items()
        values = {**values, "fan_rest": [{"from": begin, "until": end} for begin, end in pairs]}
    return EarlierFact(when.timestamp(), FactKind(given.pop("kind")), settings=values, **given)
