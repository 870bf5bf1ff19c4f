"""A host's link and a board in memory, joined by two lines, in steps of simulated time."""

from dataclasses import dataclass, field

from line import GoodLine

from firmware_protocol.link import Link, LinkEvent
from firmware_protocol.messages import CommandMessage, Message, Quality
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.core import BoardCore, Pins

STEP_MS = 10


@dataclass
class Exchange:
    """Time in ms, the same for both ends; the board's clock may begin elsewhere."""

    to_board: GoodLine = field(default_factory=GoodLine)
    to_host: GoodLine = field(default_factory=GoodLine)
    config: BoardConfig = field(default_factory=BoardConfig)
    clock_start_ms: int = 0
    temp_air: float | None = 21.0
    now_ms: int = 0
    boots: int = 0
    events: list[LinkEvent] = field(default_factory=list)
    pins: Pins | None = None
    persistent: bytes = b""
    obeyed: list[tuple[int, CommandMessage]] = field(default_factory=list)  # time [ms] and command

    def __post_init__(self) -> None:
        self.link = Link(session=0x12345678, now=0.0)
        self.core = self._boot()

    def _boot(self) -> BoardCore:
        self.boots += 1
        core = BoardCore(self.config, self.persistent, 0, self.boots)
        obey = core._safety.obey

        def record(command: CommandMessage, now_ms: int) -> bool:
            obeyed = obey(command, now_ms)
            if obeyed:
                self.obeyed.append((self.now_ms, command))
            return obeyed

        core._safety.obey = record
        return core

    def reset_board(self) -> None:
        self.persistent = self.core.persistent()
        self.core = self._boot()

    @property
    def now(self) -> float:
        return self.now_ms / 1000

    def step(self) -> Pins:
        """10 ms: what both ends wrote is carried, then both work."""
        self.now_ms += STEP_MS
        board_ms = (self.clock_start_ms + self.now_ms) % 2**32
        self.events += self.link.poll(self.now)
        self.core.receive(self.to_board.carry(self.link.outgoing(), self.now), board_ms)
        if self.now_ms % 1000 == STEP_MS:
            self.core.sample({"temp_air_c": (self.temp_air, Quality.GOOD)}, board_ms)
        self.pins = self.core.step(board_ms)
        self.events += self.link.receive(self.to_host.carry(self.core.transmit(), self.now), self.now)
        return self.pins

    def run(self, seconds: float) -> list[LinkEvent]:
        """Events of the next seconds."""
        before = len(self.events)
        for _ in range(round(seconds * 1000 / STEP_MS)):
            self.step()
        return self.events[before:]

    def request(self, message: Message) -> None:
        self.link.request(message, self.now)
