"""The relay's share is that of the board's window."""

import pytest

from bench.boxes.clairvoyant import WINDOW_S, relay_share
from firmware_protocol.virtual_board.board_config import PWM_SLOTS
from firmware_protocol.virtual_board.board_outputs import SlowPwm

SLOT_S = WINDOW_S / PWM_SLOTS


@pytest.mark.parametrize("steps", [0, 1, 12, PWM_SLOTS])
@pytest.mark.parametrize("part_slots", [1, 5])
def test_the_relay_is_closed_as_the_board_closes_it(steps: int, part_slots: int) -> None:
    pwm = SlowPwm(round(1000 * SLOT_S), steps=steps)
    closed = []
    for slot in range(3 * PWM_SLOTS):
        pwm.advance(round(1000 * SLOT_S * slot), steps)
        closed.append(pwm.relay)
    for begin in range(0, len(closed), part_slots):
        share = relay_share(steps / PWM_SLOTS, SLOT_S * begin, SLOT_S * part_slots)
        assert share == pytest.approx(sum(closed[begin : begin + part_slots]) / part_slots)
