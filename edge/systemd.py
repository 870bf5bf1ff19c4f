"""Notices to systemd (sd_notify(3)): readiness, status, watchdog. Without systemd every call does nothing."""

import os
import socket


class Notifier:
    """A datagram socket to the service manager, named by $NOTIFY_SOCKET."""

    def __init__(self, address: str | None) -> None:
        self._address = address
        self._socket = (
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None
        )

    @classmethod
    def from_environment(cls) -> "Notifier":
        """The manager that started this process, if one did."""
        address = os.environ.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of an abstract socket.
        return cls(f"\0{address[1:]}" if address.startswith("@") else address or None)

    def ready(self, status: str) -> None:
        """Start-up is over: the first tick has run."""
        self._send(f"READY=1\nSTATUS={status}")

    def alive(self, status: str) -> None:
        """Only the loop calls this, at the end of a whole tick, so a hung loop is caught."""
        self._send(f"WATCHDOG=1\nSTATUS={status}")

    def stopping(self) -> None:
        """The daemon is on its way down."""
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


def watchdog_period_s() -> float | None:
    """Half of $WATCHDOG_USEC, or None when no watchdog runs."""
    microseconds = os.environ.get("WATCHDOG_USEC", "")
    return int(microseconds) / 2e6 if microseconds.isdecimal() else None
