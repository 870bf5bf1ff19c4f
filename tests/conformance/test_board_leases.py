"""Every output falls to its safe state by itself: the edge, one ms either side, across the clock's wrap."""

from dataclasses import replace

import pytest
from board_bench import CONFIG, HEAT, IDLE, BoardBench, heating

WRAP = 2**32
STARTS = [0, 123_456, WRAP - 5000, WRAP - 1]
RUNNING_MS = 2500  # the air sample lasts 3000 ms


def driven(bench: BoardBench) -> tuple:
    """Return the outputs of the last command; the heater by its duty, since the relay waits for its slot."""
    pins, state = bench.step(), bench.state()
    return state.heater_steps, pins.fan, pins.led, state.led_pct, pins.cutoff_open


ON = (20, True, 0.6, 60, False)
OFF = (0, False, 0.0, 0, True)


@pytest.mark.parametrize("start_ms", STARTS)
@pytest.mark.parametrize("lease_ms", [1, 2, 99, 100, 101, 1000, 2999])
def test_outputs_hold_to_the_last_ms_of_the_lease(new_board, start_ms, lease_ms):
    bench = heating(new_board, replace(HEAT, lease_s=lease_ms / 1000), start_ms=start_ms)
    bench.now_ms += lease_ms - 1
    assert driven(bench) == ON
    assert bench.state().lease_left_s == 0.001
    bench.now_ms += 1
    assert driven(bench) == OFF
    assert (bench.state().lease_left_s, bench.state().heater_off_cause.name) == (0, "LEASE_EXPIRED")


@pytest.mark.parametrize("start_ms", STARTS)
@pytest.mark.parametrize("lease_s", [9.999, 10.0, 10.001, 59.999, 60.0])
def test_a_lease_is_cut_to_the_longest(new_board, start_ms, lease_s):
    bench = heating(new_board, replace(HEAT, lease_s=lease_s), start_ms=start_ms)
    cut_ms = min(round(lease_s * 1000), 10_000)
    assert bench.state().lease_left_s == cut_ms / 1000
    bench.run(9_900)
    bench.now_ms += cut_ms - 9_901
    assert driven(bench) == ON
    bench.now_ms += 1
    assert driven(bench) == OFF


def test_a_lease_of_nothing_lets_go_at_once(new_board):
    bench = heating(new_board)
    assert bench.ask(replace(HEAT, lease_s=0.0)).heater_steps == 0
    assert driven(bench) == OFF


def test_a_new_command_begins_a_new_lease(new_board):
    bench = heating(new_board)
    for _ in range(5):
        bench.run(9_900)
        assert bench.ask(HEAT).lease_left_s == 10.0
    assert driven(bench) == ON


def test_a_shorter_lease_replaces_a_longer(new_board):
    bench = heating(new_board)
    bench.ask(replace(HEAT, lease_s=0.2))
    bench.run(200)
    assert driven(bench) == OFF


@pytest.mark.parametrize("fan_safe_on", [False, True])
def test_silence_leaves_the_fan_in_its_configured_state(new_board, fan_safe_on):
    config = replace(CONFIG, fan_safe_on=fan_safe_on)
    bench = BoardBench(new_board, config)
    assert bench.step().fan is fan_safe_on
    bench.greet().air(25.0).ask(replace(HEAT, fan_on=not fan_safe_on))
    assert bench.step(100).fan is not fan_safe_on
    assert bench.run(10_000)[-1].fan is fan_safe_on


def test_a_lease_that_ended_does_not_come_back_when_the_clock_comes_round(new_board):
    bench = heating(new_board, start_ms=1000)
    bench.run(10_000)
    bench.now_ms += WRAP - 10_000
    bench.air(25.0)
    assert driven(bench) == OFF


def test_one_very_late_step_ends_the_lease(new_board):
    bench = heating(new_board)
    bench.step(10**9)
    assert driven(bench) == OFF


def test_garbage_and_reports_renew_nothing(new_board):
    bench = heating(new_board)
    for _ in range(100):
        bench.receive(b"\x03garbage\x00")
        bench.run(100)
    assert driven(bench) == OFF


def test_asking_renews_nothing(new_board):
    bench = heating(new_board)
    for _ in range(100):
        bench.state()
        bench.run(100)
    bench.greet()
    assert driven(bench) == OFF


def test_the_cut_off_obeys_and_is_open_without_a_lease(new_board):
    bench = BoardBench(new_board)
    assert bench.step().cutoff_open
    bench.greet().air(25.0).ask(IDLE)
    assert not bench.step(100).cutoff_open
    bench.ask(replace(IDLE, cutoff_open=True))
    assert bench.step(100).cutoff_open


# ---- the fan for a part of its lease


@pytest.mark.parametrize("start_ms", STARTS)
@pytest.mark.parametrize("fan_on", [2, 3, 20, 39])
@pytest.mark.parametrize("fan_safe_on", [False, True])
def test_the_fan_turns_for_its_time_and_no_ms_longer(new_board, start_ms, fan_on, fan_safe_on):
    config = replace(CONFIG, fan_safe_on=fan_safe_on)
    bench = heating(new_board, replace(HEAT, fan_on=fan_on), start_ms=start_ms, config=config)
    bench.run(250 * fan_on - 100)
    bench.air(25.0)
    assert bench.step(50 * (fan_on % 2) + 99).fan
    assert not bench.step(1).fan
    bench.run(9_900 - 250 * fan_on)
    assert not bench.step().fan
    assert bench.run(200)[-1].fan is fan_safe_on


@pytest.mark.parametrize("fan_on", [40, 41, 255])
def test_the_fan_s_time_ends_with_its_lease(new_board, fan_on):
    bench = heating(new_board, replace(HEAT, fan_on=fan_on))
    assert bench.run(9_900)[-1].fan
    assert bench.step(99).fan
    assert not bench.step(1).fan


def test_a_renewal_tells_what_is_left_of_the_fan_s_time(new_board):
    bench = heating(new_board, replace(HEAT, fan_on=20))
    assert bench.run(3000)[-1].fan
    bench.ask(replace(HEAT, fan_on=8))
    assert bench.run(1900)[-1].fan
    assert not bench.run(100)[-1].fan
    bench.ask(replace(HEAT, fan_on=0))
    assert not bench.run(100)[-1].fan


# ---- the valve's pulse, bounded by itself as well


@pytest.mark.parametrize("pulse_s", [0.1, 0.2, 1.0, 4.9, 5.0, 5.1, 25.5])
@pytest.mark.parametrize("start_ms", STARTS)
def test_a_pulse_ends_to_the_ms_and_is_cut_to_the_longest(new_board, pulse_s, start_ms):
    bench = heating(new_board, replace(IDLE, valve_pulse_s=pulse_s), start_ms=start_ms)
    ends_ms = round(min(pulse_s, 5.0) * 1000)
    assert bench.step().valve
    assert bench.step(ends_ms - 1).valve
    assert not bench.step(1).valve
    assert not any(pins.valve for pins in bench.run(20_000))


def test_a_pulse_goes_on_through_a_renewed_lease_and_ends_for_good_with_the_lease(new_board):
    bench = heating(new_board, replace(IDLE, valve_pulse_s=3.0, lease_s=1.0))
    bench.step(900)
    bench.ask(replace(IDLE, lease_s=1.0))
    assert bench.step(999).valve
    assert not bench.step(1).valve
    bench.ask(IDLE)
    assert not bench.step(1).valve


def test_a_new_pulse_replaces_the_old_one(new_board):
    bench = heating(new_board, replace(IDLE, valve_pulse_s=5.0))
    bench.step(1000)
    bench.ask(replace(IDLE, valve_pulse_s=0.5))
    assert bench.step(499).valve
    assert not bench.step(1).valve


def test_a_board_that_allows_no_pulse_gives_none(new_board):
    bench = heating(
        new_board, replace(IDLE, valve_pulse_s=1.0), config=replace(CONFIG, valve_pulse_max_s=0.0)
    )
    assert not bench.step().valve
