"""The heater relay's slow window: 20 slots, the first k closed."""

from dataclasses import replace
from itertools import pairwise

import pytest
from board_bench import CONFIG, HEAT, BoardBench, heating
from hypothesis import given, settings
from hypothesis import strategies as st

WINDOW_MS = 20_000
SLOT_MS = 1000
STARTS = [0, 17_300, 2**32 - 30_000]


def renewed(bench: BoardBench, duty: int, duration_ms: int) -> list[bool]:
    """The relay every 100 ms while a duty is held and its lease renewed."""
    relay = []
    for _ in range(duration_ms // 5000):
        bench.ask(replace(HEAT, heater_steps=duty))
        relay += [pins.heater_relay for pins in bench.run(5000)]
    return relay


@pytest.mark.parametrize("start_ms", STARTS)
@pytest.mark.parametrize("duty", range(21))
def test_a_window_closes_the_relay_for_as_many_slots_as_the_duty(new_board, duty, start_ms):
    bench = heating(new_board, start_ms=start_ms)
    renewed(bench, duty, WINDOW_MS)
    relay = renewed(bench, duty, 3 * WINDOW_MS)
    per_window = WINDOW_MS // 100
    for window in range(3):
        closed = relay[window * per_window : (window + 1) * per_window]
        assert sum(closed) * 100 == duty * SLOT_MS
    switched = sum(a != b for a, b in pairwise(relay))
    assert switched <= 6  # one closing and one opening a window


def test_the_closed_slots_come_first(new_board):
    bench = heating(new_board)
    bench.run(WINDOW_MS - 100)
    assert [k for k, closed in enumerate(renewed(bench, 5, WINDOW_MS)) if closed] == list(range(50))


@pytest.mark.parametrize("lower", range(20))
def test_less_duty_opens_the_relay_at_once(new_board, lower):
    bench = heating(new_board)
    renewed(bench, 20, 10_000)
    bench.run(100)
    assert bench.pins.heater_relay  # 10.1 s into the window: slot 10
    bench.ask(replace(HEAT, heater_steps=lower))
    assert bench.step().heater_relay is (lower > 10)


def test_more_duty_waits_for_the_next_slot(new_board):
    bench = heating(new_board)
    renewed(bench, 2, 5000)
    bench.run(100)
    bench.ask(replace(HEAT, heater_steps=10))
    assert [pins.heater_relay for pins in bench.run(1000)] == [False] * 8 + [True] * 2


def test_back_and_forth_within_a_slot_does_not_chatter(new_board):
    bench = heating(new_board)
    renewed(bench, 20, 5000)
    bench.run(100)
    for duty in (0, 20, 3, 20):
        bench.ask(replace(HEAT, heater_steps=duty))
        assert not bench.step().heater_relay
    assert bench.step(900).heater_relay


@pytest.mark.parametrize("window_s", [1.0, 1.1, 2.0, 20.0, 40.0])
def test_the_window_is_the_configured_one(new_board, window_s):
    slot_ms = round(window_s * 1000) // 20
    bench = heating(new_board, config=replace(CONFIG, pwm_window_s=window_s))
    relay = []
    for _ in range(60):
        bench.now_ms += slot_ms
        bench.air(25.0).ask(replace(HEAT, heater_steps=7))
        relay.append(bench.step().heater_relay)
    assert sum(relay[20:40]) == sum(relay[40:]) == 7


@settings(max_examples=60, deadline=None)
@given(duties=st.lists(st.tuples(st.integers(0, 20), st.integers(1, 40)), min_size=1, max_size=30))
def test_the_relay_closes_only_with_a_slot_and_never_without_duty(new_board, duties):
    bench = heating(new_board)
    closed = False
    for duty, steps in duties:
        bench.ask(replace(HEAT, heater_steps=duty))
        for _ in range(steps):
            before, closed = closed, bench.run(100)[-1].heater_relay
            assert not closed or (duty > 0 and (before or bench.now_ms % SLOT_MS == 0))
