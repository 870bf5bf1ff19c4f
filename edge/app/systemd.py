"""Notices to systemd (sd_notify(3)): readiness, status, watchdog. Without systemd every call does nothing."""

import os
import socket

WATCHDOG_STEPS = 2.5  # over two, so that one late tick is no reason for a restart
WATCHDOG_MIN_S = 15.0  # a stall of the disk or of a busy machine is no hang


def watchdog_s(step_s: float) -> float:
    """How long a loop of this step may be silent [s]; the unit's WatchdogSec= is that of the default step."""
    return max(WATCHDOG_MIN_S, WATCHDOG_STEPS * step_s)


class Notifier:
    """A datagram socket to the service manager, named by $NOTIFY_SOCKET."""

    def __init__(self, address: str | None, watched: bool = False) -> None:
        """`watched`: the manager runs a watchdog, which is then set to the loop's step."""
        self._address = address
        self._watched = watched
        self._socket = (
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None
        )

    @classmethod
    def from_environment(cls) -> "Notifier":
        """Return the notifier of the manager that started this process, if one did."""
        address = os.environ.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of an abstract socket.
        watched = bool(os.environ.get("WATCHDOG_USEC"))
        return cls(f"\0{address[1:]}" if address.startswith("@") else address or None, watched)

    def ready(self, status: str, step_s: float) -> None:
        """Start-up is over: the first tick has run, and from here on one comes every `step_s`."""
        watchdog = f"\nWATCHDOG_USEC={watchdog_s(step_s) * 1e6:.0f}" if self._watched else ""
        self._send(f"READY=1\nSTATUS={status}{watchdog}")

    def alive(self, status: str) -> None:
        """Only the loop calls this, at the end of a whole tick, so a hung loop is caught."""
        self._send(f"WATCHDOG=1\nSTATUS={status}")

    def stopping(self) -> None:
        """Tell the manager that the daemon is stopping."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, text: str) -> None:
        if self._socket is None or self._address is None:
            return
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            # A manager that is gone must not stop control; a missing ping is what the watchdog is for.
            return
