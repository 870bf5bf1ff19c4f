"""Ending an exchange from outside: at its deadline, when nobody waits for it any more, at the end."""

import socket
import threading
from contextlib import suppress


class Interrupt:
    """Fired once, for good. Sockets that are held here are shut down, so that no read outlasts it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fired = threading.Event()
        self._sockets: list[socket.socket] = []

    @property
    def fired(self) -> bool:
        """True when the work must end."""
        return self._fired.is_set()

    def fire(self) -> None:
        """From any thread."""
        with self._lock:
            self._fired.set()
            for held in self._sockets:
                with suppress(OSError):  # not connected any more
                    held.shutdown(socket.SHUT_RDWR)

    def hold(self, connection: socket.socket) -> None:
        """Shut `connection` down when fired; a second descriptor of it is kept, which TLS does not wrap."""
        with self._lock:
            self._sockets.append(connection.dup())
        if self.fired:
            self.fire()

    def wait(self, seconds: float) -> bool:
        """Pause; return True early when interrupted."""
        return self._fired.wait(seconds)

    def let_go(self) -> None:
        """Close what was held."""
        with self._lock:
            for held in self._sockets:
                held.close()
            self._sockets.clear()
