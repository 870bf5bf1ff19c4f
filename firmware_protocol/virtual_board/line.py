"""One direction of the serial line, and what spoils the bytes on it."""

from collections import deque
from collections.abc import Callable

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
