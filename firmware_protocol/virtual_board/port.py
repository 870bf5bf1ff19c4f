"""The board's end of the serial line: a pseudo-terminal that can be unplugged, and faults of its bytes.

A host that closes its end gets a new pseudo-terminal at its next opening, so bytes are counted from there.
"""

import errno
import fcntl
import os
import select
import struct
import termios
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path

from firmware_protocol.virtual_board.faults import BoardFault

Spoil = Callable[[bytes, BoardFault], bytes]


def drop(data: bytes, fault: BoardFault) -> bytes:
    """Lose some bytes."""
    rate, dice = fault.number("rate"), fault.random
    return bytes(byte for byte in data if dice.random() >= rate)


def duplicate(data: bytes, fault: BoardFault) -> bytes:
    """Receive some bytes twice."""
    rate, dice = fault.number("rate"), fault.random
    return bytes(byte for byte in data for _ in range(1 + (dice.random() < rate)))


def flip(data: bytes, fault: BoardFault) -> bytes:
    """Turn one bit of some bytes."""
    rate, dice = fault.number("rate"), fault.random
    return bytes(byte ^ (1 << dice.randrange(8) if dice.random() < rate else 0) for byte in data)


def mute(data: bytes, fault: BoardFault) -> bytes:
    """Lose everything."""
    return b""


SPOILS: dict[str, Spoil] = {"drop_bytes": drop, "duplicate_bytes": duplicate, "flip_bits": flip, "mute": mute}


class FaultyLine:
    """Bytes go in with a time and come out in order, spoilt and delayed by the faults that last."""

    def __init__(self, direction: str) -> None:
        self._direction = direction
        self._spoils: list[BoardFault] = []
        self._delay_ms = 0
        self._under_way: deque[tuple[int, bytes]] = deque()
        self.bytes_sent = 0
        self.bytes_arrived = 0

    @property
    def next_arrival_ms(self) -> float:
        """When the next bytes arrive [ms]; infinite when none are under way."""
        return self._under_way[0][0] if self._under_way else float("inf")

    def set_faults(self, active: list[BoardFault]) -> None:
        """From now on these last."""
        mine = [fault for fault in active if fault.concerns(self._direction)]
        self._spoils = [fault for fault in mine if fault.name in SPOILS]
        self._delay_ms = sum(round(fault.number("delay_s") * 1000) for fault in mine if fault.name == "delay")

    def garbage(self, fault: BoardFault, now_ms: int) -> None:
        """Return a burst of random bytes."""
        if fault.concerns(self._direction):
            self.send(fault.random.randbytes(int(fault.number("count"))), now_ms)

    def send(self, data: bytes, now_ms: int) -> None:
        """Put bytes in."""
        self.bytes_sent += len(data)
        for fault in self._spoils:
            data = SPOILS[fault.name](data, fault)
        if data:
            due_ms = now_ms + self._delay_ms
            if self._under_way:  # a line keeps the order, also when a delay ends
                due_ms = max(due_ms, self._under_way[-1][0])
            self._under_way.append((due_ms, data))

    def arrive(self, now_ms: int) -> bytes:
        """Take out what has arrived."""
        data = b""
        while self._under_way and self._under_way[0][0] <= now_ms:
            data += self._under_way.popleft()[1]
        self.bytes_arrived += len(data)
        return data

    def cut(self) -> None:
        """Lose what is under way (the plug is out)."""
        self._under_way.clear()


_CHUNK = 4096
_UNLOCK = 0x40045431  # TIOCSPTLCK, linux/asm-generic/ioctls.h
_NUMBER = 0x80045430  # TIOCGPTN


class PseudoTerminal:
    """A pseudo-terminal, or none while unplugged. `bytes_in`, `bytes_out` count from its creation."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self._master: int | None = None
        self.bytes_in = 0
        self.bytes_out = 0
        self.bytes_lost = 0  # sent while nobody read, since the start
        self.user: object = None  # who reads what is written; None: nobody yet
        self.device = ""  # the file behind the symlink

    @property
    def plugged(self) -> bool:
        """There is a device a host can open, or has open."""
        return self._master is not None

    def fileno(self) -> int:
        """Descriptor to wait on; -1 while unplugged."""
        return -1 if self._master is None else self._master

    def plug(self) -> None:
        """Make a new pseudo-terminal, point the symlink at it, count from 0."""
        old = self._master
        self._master, self.device = _open_pseudo_terminal()
        self._begin()
        if old is not None:
            os.close(old)

    def _plug_after_close(self) -> None:
        """Make a new pseudo-terminal, unless the next host has opened the old one before it was there."""
        old, old_device = self._master, self.device
        assert old is not None
        self._master, self.device = _open_pseudo_terminal()
        self._begin()
        if _has_host(old):
            old, self._master, self.device = self._master, old, old_device
            self._begin()
        os.close(old)

    def _begin(self) -> None:
        self.bytes_in = self.bytes_out = 0
        self.user = None
        beside = self._link.with_name(self._link.name + ".new")
        beside.unlink(missing_ok=True)
        beside.symlink_to(self.device)
        beside.replace(self._link)  # in one go: a host that opens now finds the old one or the new one

    def unplug(self) -> None:
        """Take symlink and device away; the host's reads and writes fail from now on."""
        if self._master is None:
            return
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        self._master = None

    def read(self) -> bytes:
        """All bytes the host has written, maybe none. When it has closed, the next one gets a new device."""
        data = bytearray()
        while self._master is not None:
            try:
                data += os.read(self._master, _CHUNK)
            except BlockingIOError:
                break
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
                self._plug_after_close()
                return bytes(data)
        self.bytes_in += len(data)
        return bytes(data)

    def write(self, data: bytes) -> None:
        """Hand `data` to the host; what finds no room or no user is lost, as on a wire."""
        try:
            written = 0 if self._master is None or self.user is None else os.write(self._master, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            written = 0
        self.bytes_out += written
        self.bytes_lost += len(data) - written


def _has_host(master: int) -> bool:
    """Return whether a host has the other end open."""
    poll = select.poll()
    poll.register(master, 0)
    return not poll.poll(0)  # POLLHUP comes unasked


def _open_pseudo_terminal() -> tuple[int, str]:
    """Open a raw, non-blocking master; return it and the name of its device, which is not opened here.

    So the master hangs up when, and only when, a host has closed the device.
    """
    master = os.open("/dev/ptmx", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    fcntl.ioctl(master, _UNLOCK, struct.pack("i", 0))
    (number,) = struct.unpack("i", fcntl.ioctl(master, _NUMBER, struct.pack("i", 0)))
    tty.setraw(master, termios.TCSANOW)
    return master, f"/dev/pts/{number}"
