"""Outputs of the board, their leases, and the heater relay's slow PWM."""

from dataclasses import dataclass

from firmware_protocol.virtual_board.board_config import PWM_SLOTS
from firmware_protocol.virtual_board.board_samples import elapsed_ms


@dataclass(frozen=True, slots=True)
class Pins:
    """The board's outputs."""

    heater_relay: bool
    fan: bool
    led: float  # 0..1
    valve: bool
    cutoff_open: bool  # False where there is no cut-off


@dataclass(slots=True)
class Lease:
    """Permission that ends by itself, less than `length_ms` after `start_ms`."""

    start_ms: int = 0
    length_ms: int = 0  # 0: not running

    @property
    def runs(self) -> bool:
        """True while the output may be driven."""
        return self.length_ms > 0

    def grant(self, now_ms: int, length_ms: int, longest_ms: int) -> None:
        """Begin anew."""
        self.start_ms = now_ms
        self.length_ms = min(length_ms, longest_ms)

    def end(self) -> None:
        """Stop at once."""
        self.length_ms = 0

    def advance(self, now_ms: int) -> None:
        """End it when its time is over; it stays ended when the clock wraps."""
        if elapsed_ms(now_ms, self.start_ms) >= self.length_ms:
            self.end()

    def left_ms(self, now_ms: int) -> int:
        """Return the time left [ms]."""
        return self.length_ms - elapsed_ms(now_ms, self.start_ms) if self.runs else 0


@dataclass(slots=True)
class SlowPwm:
    """The heater relay's window of PWM_SLOTS slots."""

    slot_ms: int
    slot_start_ms: int = 0
    slot: int = 0
    steps: int = 0  # duty taken for this slot

    def advance(self, now_ms: int, wanted: int) -> None:
        """At a slot's beginning the duty of that moment is taken, within a slot only a smaller one."""
        passed = elapsed_ms(now_ms, self.slot_start_ms) // self.slot_ms
        if passed > 0:
            self.slot_start_ms += passed * self.slot_ms
            self.slot = (self.slot + passed) % PWM_SLOTS
            self.steps = wanted
        self.reduce(wanted)

    def reduce(self, wanted: int) -> None:
        """Less heat at once; more has to wait for the next slot, so that the relay never chatters."""
        self.steps = min(self.steps, wanted)

    @property
    def relay(self) -> bool:
        """True while the relay is closed."""
        return self.slot < self.steps
