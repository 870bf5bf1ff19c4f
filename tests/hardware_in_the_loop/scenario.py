"""A scenario: a short YAML file that says what happens to the rig and what must come of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tests.support.watched_clock import TimedRequest

FOLDER = Path(__file__).parent / "scenarios"


@dataclass(frozen=True, slots=True)
class HeaterOff:
    """The heater pin is off from `from_s + within_s` until `until_s`."""

    from_s: float
    until_s: float
    within_s: float = 10.0  # one lease


@dataclass(frozen=True, slots=True)
class Scenario:
    """The faults and orders, and the expected end. Times in s since the
    start; a tick is at 1 s and every 60 s.

    The heater is on at full duty from the first tick until the first fault or order.
    """

    about: str
    end_s: float
    faults: tuple[dict[str, Any], ...] = ()
    orders: tuple[dict[str, Any], ...] = ()  # {at_s, do, ...}
    settings: dict[str, Any] = field(default_factory=dict)  # changes to edge.yaml
    board: tuple[str, ...] = ()  # options of the virtual board
    chamber: dict[str, Any] = field(default_factory=dict)  # changes to chamber.yaml
    heater_off: tuple[HeaterOff, ...] = ()
    heats_from_s: float | None = None  # from here on the heater pin is on again; None: never
    orders_refused: int = 0
    told: tuple[str, ...] = ()  # keys of events in the history, among others
    alarms: tuple[str, ...] = ()  # keys of all alarms in the history
    may_alarm: tuple[str, ...] = ()  # keys of alarms that chance decides
    conditions: tuple[str, ...] = ()  # keys of the failure table whose begin and end are in the history

    def given(self) -> list[TimedRequest]:
        """The orders as the clock takes them."""
        return [
            TimedRequest(order["at_s"], {k: v for k, v in order.items() if k != "at_s"})
            for order in self.orders
        ]


def read(path: Path) -> Scenario:
    """Errors: TypeError for an unknown key."""
    values = yaml.safe_load(path.read_text())
    values["heater_off"] = tuple(HeaterOff(**window) for window in values.get("heater_off", ()))
    return Scenario(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})


def names() -> list[str]:
    """Names of all scenario files."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))
