"""A lock-step clock that looks at what is really so in the box, every second, while the daemon waits."""

import select
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.board.sim_clock import SimClock
from edge.core.clock import Port
from edge.sockets.client import request

ACTUATORS = ("heater_relay", "fan", "led", "valve")
ARRIVAL_S = 10.0  # real time an order may take to reach the daemon


@dataclass(frozen=True, slots=True)
class Look:
    """The truth at one moment."""

    time_s: float
    temp_air_c: float
    heater_pin: bool
    heater_pin_last_on_s: float | None
    heat: bool  # what flows, whatever the pin says
    fan: bool
    cutoff_open: bool
    tank_level: float
    pins_on: tuple[str, ...] = ()  # of heater_relay, fan, led, valve


@dataclass(frozen=True, slots=True)
class TimedRequest:
    """A person's request over the control socket, and when."""

    at_s: float
    request: Mapping[str, Any]


class WatchedClock:
    """A `Clock`: that of the board, with looks every `period_s`; hands the orders over at their time."""

    def __init__(
        self,
        board: SimClock,
        socket: Path,
        orders: Sequence[TimedRequest],
        period_s: float = 1.0,
        on_look: Callable[[Look], None] = lambda look: None,
        on_reply: Callable[[float, TimedRequest, Mapping[str, Any]], None] = lambda given_s, order, reply: (
            None
        ),
    ) -> None:
        self.looks: list[Look] = []
        self._on_look, self._on_reply = on_look, on_reply
        self.replies: list[Mapping[str, Any]] = []
        self._board = board
        self._socket = socket
        self._orders = sorted(orders, key=lambda order: order.at_s)
        self._period_s = period_s
        self._look_s = 0.0

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._board.now()

    def utc(self) -> float:
        """Return the simulated time [s since 1970]."""
        return self._board.utc()

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """As SimClock; comes back early to look and to give orders."""
        # Where the loop listens to the board alone, an order waits, and must not keep time from moving.
        next_order_s = self._orders[0].at_s if self._orders and wake is not None else until_s
        self._board.wait(port, wake, min(until_s, self._look_s, next_order_s))
        if self.now() >= self._look_s:
            self._look_s = self.now() + self._period_s
            self.looks.append(look_at(self._board.truth()))
            self._on_look(self.looks[-1])
        if wake is not None and self._orders and self.now() >= self._orders[0].at_s:
            self._give(self._orders.pop(0), wake)

    def _give(self, order: TimedRequest, wake: int) -> None:
        """Give an order; simulated time stands still until the order is in the daemon's inbox."""
        threading.Thread(target=self._ask, args=(self.now(), order)).start()
        arrived, _, _ = select.select([wake], [], [], ARRIVAL_S)
        assert arrived, f"{order} did not reach the daemon"

    def _ask(self, given_s: float, order: TimedRequest) -> None:
        self.replies.append(request(self._socket, order.request))
        self._on_reply(given_s, order, self.replies[-1])


def look_at(truth: Mapping[str, Any]) -> Look:
    """Return the answer to a request for the truth as a Look."""
    return Look(
        time_s=truth["time_s"],
        temp_air_c=truth["chamber"]["temp_air_c"],
        heater_pin=truth["pins"]["heater_relay"],
        heater_pin_last_on_s=truth["heater_pin_last_on_s"],
        heat=truth["heat_on"],
        fan=truth["fan_on"],
        cutoff_open=truth["pins"]["cutoff_open"],
        tank_level=truth["chamber"]["tank_level"],
        pins_on=tuple(name for name in ACTUATORS if truth["pins"][name]),
    )
