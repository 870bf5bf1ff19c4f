"""A rig and a Home Assistant beside each other: what each says, and orders that are timed."""

import time
from collections.abc import Callable
from typing import Any

from server import RealHomeAssistant

from tests.support.broker import wait_for
from tests.support.daemon_process import DaemonProcess
from tests.support.virtual_board import VirtualBoard

LIMIT_S = 2.0
RIG = "greenhouse-1"  # as in the dashboard

Holds = Callable[[], bool]


class HomeRun:
    """Tools of the checks, and the lines of their results."""

    def __init__(self, home: RealHomeAssistant, daemon: DaemonProcess, board: VirtualBoard) -> None:
        self.home, self.daemon, self.board = home, daemon, board
        self.lines: list[str] = []
        self.slowest_s = 0.0

    def say(self, line: str) -> None:
        """Print and keep a line of the results."""
        self.lines.append(line)
        print(line, flush=True)

    def operation(self) -> dict[str, Any]:
        """Return the daemon's standing orders, by its control socket."""
        return dict(self.daemon.ask("status")["operation"])

    def state(self, id: str) -> Any:
        """Return the state that Home Assistant shows. id : `switch.stop`, without the rig's name"""
        return self.home.entity(entity_id(id))["state"]

    def attribute(self, id: str, name: str) -> Any:
        """Return an attribute that Home Assistant shows."""
        return self.home.entity(entity_id(id))["attributes"].get(name)

    def call(self, service: str, id: str, **values: Any) -> None:
        """Touch a card."""
        self.home.call(service, entity_id(id), **values)

    def order(self, name: str, give: Callable[[], Any], obeyed: Holds, shown: Holds) -> None:
        """Give an order, and hold the rig to obey it and Home Assistant to show it within 2 s each."""
        begin = time.monotonic()
        give()
        wait_for(obeyed, f"{name}: obeyed", LIMIT_S)
        obeyed_s = time.monotonic() - begin
        wait_for(shown, f"{name}: shown", LIMIT_S)
        shown_s = time.monotonic() - begin
        assert shown_s <= LIMIT_S, f"{name}: shown after {shown_s:.2f} s"
        self.slowest_s = max(self.slowest_s, shown_s)
        self.say(f"  {name:58s} obeyed {obeyed_s:5.2f} s, shown {shown_s:5.2f} s")


def entity_id(id: str) -> str:
    """Return the id with the rig's name in it."""
    platform, _, key = id.partition(".")
    return f"{platform}.{RIG.replace('-', '_')}_{key}"
