"""Lines between two ends, in memory and without clocks: each takes bytes and the time and gives bytes later.

All are first in, first out, as a serial line is; what they spoil is decided by a seed.
"""

import random
from dataclasses import dataclass, field


@dataclass
class GoodLine:
    """A good line. `carry` takes what was written now and returns what arrives now [bytes], time in s."""

    def carry(self, data: bytes, now: float) -> bytes:
        return data


@dataclass
class BytewiseLine(GoodLine):
    """Delivers a byte (or a few) each time it is asked."""

    at_once: int = 1
    held: bytearray = field(default_factory=bytearray)

    def carry(self, data: bytes, now: float) -> bytes:
        self.held += data
        arrived = bytes(self.held[: self.at_once])
        del self.held[: self.at_once]
        return arrived


@dataclass
class DelayedLine(GoodLine):
    """Delivers everything `delay_s` later."""

    delay_s: float
    held: list[tuple[float, bytes]] = field(default_factory=list)

    def carry(self, data: bytes, now: float) -> bytes:
        if data:
            self.held.append((now + self.delay_s, data))
        arrived = b"".join(part for due, part in self.held if due <= now)
        self.held = [(due, part) for due, part in self.held if due > now]
        return arrived


@dataclass
class DuplicatingLine(GoodLine):
    """Delivers every frame twice, at random."""

    seed: int
    share: float = 0.5
    held: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        self.held += data
        *frames, rest = bytes(self.held).split(b"\0")
        self.held = bytearray(rest)
        copies = (2 if self._random.random() < self.share else 1 for _ in frames)
        return b"".join((frame + b"\0") * n for frame, n in zip(frames, copies, strict=True))


@dataclass
class LossyLine(GoodLine):
    """Drops, flips and inserts bytes, each with a probability of its own."""

    seed: int
    drop: float = 0.0
    flip: float = 0.0
    insert: float = 0.0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        out = bytearray()
        for byte in data:
            if self._random.random() < self.insert:
                out.append(self._random.randrange(256))
            if self._random.random() < self.drop:
                continue
            flipped = 1 << self._random.randrange(8) if self._random.random() < self.flip else 0
            out.append(byte ^ flipped)
        return bytes(out)


@dataclass
class CutLine(GoodLine):
    """Loses everything from `from_s` to `until_s`."""

    from_s: float
    until_s: float

    def carry(self, data: bytes, now: float) -> bytes:
        return b"" if self.from_s <= now < self.until_s else data


@dataclass
class NoisyLine(GoodLine):
    """A good line on which noise follows every delivery."""

    seed: int
    share: float = 0.2

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        if self._random.random() < self.share:
            return data + self._random.randbytes(self._random.randrange(1, 80))
        return data
