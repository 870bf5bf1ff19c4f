"""A board on a bench: its clock is told, its host speaks by hand."""

from dataclasses import replace

from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import (
    Capability,
    CommandMessage,
    ErrorMessage,
    Header,
    HelloRequest,
    Message,
    Ping,
    Quality,
    StateEcho,
    pack,
    unpack,
)
from firmware_protocol.virtual_board.board_config import BoardConfig

STEP_MS = 100
CONFIG = BoardConfig(capabilities=Capability(0x03FF), valve_pulse_max_s=5.0, fan_safe_on=False)
CONFIGURABLE = replace(CONFIG, capabilities=CONFIG.capabilities | Capability.CONFIGURABLE)
HEAT = CommandMessage(
    heater_steps=20, fan_on=True, led_pct=60, valve_pulse_s=0.0, cutoff_open=False, lease_s=10.0
)
IDLE = replace(HEAT, heater_steps=0, fan_on=False, led_pct=0)


class BoardBench:
    """One board, its clock `now_ms`, the pins of its last step, the number of the host's last request."""

    def __init__(self, new_board, config=CONFIG, persistent=b"", start_ms=0, reset_cause=0, boot_count=1):
        self.board = new_board(config, persistent, reset_cause, boot_count)
        self.now_ms = start_ms
        self.seq = 0
        self.pins = None
        self.heard: list[tuple[Header, Message]] = []  # unasked frames and answers, oldest first
        self._decoder = FrameDecoder()

    def listen(self) -> list[tuple[Header, Message]]:
        """Frames since the last call."""
        new = [unpack(payload) for payload in self._decoder.feed(self.board.transmit())]
        self.heard += new
        return new

    def receive(self, data: bytes) -> list[tuple[Header, Message]]:
        """Return the board's immediate answer to bytes on its line."""
        self.listen()
        self.board.receive(data, self.now_ms)
        return self.listen()

    def ask(self, message: Message, seq: int | None = None) -> Message:
        """The one answer to a request; the next number is taken when none is given."""
        if seq is None:
            self.seq = seq = self.seq % 255 + 1
        [(header, answer)] = self.receive(encode(pack(message, seq)))
        assert header.ack == seq
        return answer

    def greet(self) -> "BoardBench":
        self.ask(HelloRequest(session=7))
        return self

    def state(self) -> StateEcho:
        answer = self.ask(Ping())
        assert isinstance(answer, StateEcho)
        return answer

    def air(self, value: float | None, quality: int = Quality.GOOD) -> "BoardBench":
        self.board.sample({"temp_air_c": (value, quality)}, self.now_ms)
        return self

    def step(self, after_ms: int = 0):
        """The pins after that much more time, in one step."""
        self.now_ms += after_ms
        self.pins = self.board.step(self.now_ms)
        return self.pins

    def run(self, duration_ms: int, air: float | None = 25.0) -> list:
        """The pins of steps every STEP_MS, with a good sample before each; `air` None gives no sample."""
        pins = []
        for _ in range(duration_ms // STEP_MS):
            self.now_ms += STEP_MS
            if air is not None:
                self.air(air)
            pins.append(self.step())
        return pins


def heating(new_board, command=HEAT, **bench) -> BoardBench:
    """A greeted board with a good sample that has just obeyed a command."""
    ready = BoardBench(new_board, **bench).greet().air(25.0)
    answer = ready.ask(command)
    assert isinstance(answer, StateEcho), answer
    return ready


def is_error(answer: Message, code: int, detail: int) -> bool:
    return answer == ErrorMessage(code, detail)
