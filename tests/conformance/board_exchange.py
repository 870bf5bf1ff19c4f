"""The host's own link and a board under test, joined by two lines, in steps of 10 ms of simulated time."""

from board_bench import CONFIG
from line import GoodLine

from firmware_protocol.link import Link
from firmware_protocol.messages import CommandMessage, Message, Quality

STEP_MS = 10
RENEW_MS = 2000


class BoardExchange:
    """A host that renews its command every RENEW_MS, an air temperature that is sampled every second."""

    def __init__(self, new_board, to_board: GoodLine | None = None, to_host: GoodLine | None = None) -> None:
        self.new_board = new_board
        self.to_board, self.to_host = to_board or GoodLine(), to_host or GoodLine()
        self.temp_air = 25.0
        self.now_ms = 0
        self.boots = 0
        self.events: list = []
        self.pins = None
        self.link = Link(session=1, now=0.0)
        self.board = None
        self.reset_board()

    def reset_board(self) -> None:
        """A new start of the board with what its store holds."""
        store = b"" if self.board is None else self.board.persistent()
        self.boots += 1
        self.board = self.new_board(CONFIG, store, 0, self.boots)

    def request(self, message: Message) -> None:
        self.link.request(message, self.now_ms / 1000)

    def drive(self, duration_s: float, command: CommandMessage | None = None) -> list:
        """The pins of every step."""
        pins = []
        for k in range(round(duration_s * 1000) // STEP_MS):
            if command is not None and k % (RENEW_MS // STEP_MS) == 0 and self.link.state == "up":
                self.request(command)
            pins.append(self._step())
        return pins

    def seen(self, kind: type) -> list:
        """The events of one kind."""
        return [event for event in self.events if isinstance(event, kind)]

    def _step(self):
        self.now_ms += STEP_MS
        now = self.now_ms / 1000
        self.events += self.link.poll(now)
        self.board.receive(self.to_board.carry(self.link.outgoing(), now), self.now_ms)
        if self.now_ms % 1000 == STEP_MS:
            self.board.sample({"temp_air_c": (self.temp_air, Quality.GOOD)}, self.now_ms)
        self.pins = self.board.step(self.now_ms)
        self.events += self.link.receive(self.to_host.carry(self.board.transmit(), now), now)
        return self.pins
