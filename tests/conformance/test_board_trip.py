"""Trips and stops latch, survive a reset and end by their own request alone; a stop turns the fan off too."""

import math
from dataclasses import replace

import pytest
from board_bench import CONFIG, HEAT, IDLE, BoardBench, heating, is_error

from firmware_protocol.frame import crc16
from firmware_protocol.messages import (
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    ErrorCode,
    Maintenance,
    ReleaseStop,
    StateEcho,
    TripCause,
)

OVER_TEMPERATURE = TripCause.OVER_TEMPERATURE
BLANK = [b"", b"\xff\xff\xff\xff"]


def tripped(new_board, **bench) -> BoardBench:
    """A board that has just tripped while heating."""
    hot = heating(new_board, replace(HEAT, fan_on=False, valve_pulse_s=5.0), **bench)
    hot.run(1000)
    return hot.air(45.0).air(45.0)


def assert_safe(pins) -> None:
    assert (pins.heater_relay, pins.fan, pins.cutoff_open) == (False, True, True)


def assert_still(pins) -> None:
    assert (pins.heater_relay, pins.fan, pins.led, pins.valve) == (False, False, 0.0, False)
    assert pins.cutoff_open


@pytest.mark.parametrize(
    "samples",
    [
        (45.0, 45.0), (44.995001, 45.0), (46.0, 45.0), (80.0, 80.0), (20.0, 45.0, 45.0, 20.0),
        (45.0, None, 45.0), (45.0, math.nan, 45.0), (45.0, 99.0, 45.0),
    ],
)  # fmt: skip
def test_two_hot_samples_trip(new_board, samples):
    bench = heating(new_board)
    for value in samples:
        bench.air(value)
    assert_safe(bench.step())
    state = bench.state()
    assert (state.tripped, state.trip_cause, state.heater_off_cause.name) == (
        True,
        OVER_TEMPERATURE,
        "TRIPPED",
    )


@pytest.mark.parametrize(
    "samples",
    [(45.0,), (44.99, 44.99, 44.99), (45.0, 44.99, 45.0), (99.0, 99.0), (None, 45.0), (44.994, 44.994)],
)
def test_less_does_not_trip(new_board, samples):
    bench = heating(new_board)
    for value in samples:
        bench.air(value)
    assert not bench.state().tripped


def test_a_trip_ends_everything_at_once(new_board):
    bench = tripped(new_board)
    pins = bench.step()
    assert_safe(pins)
    assert (pins.led, pins.valve, bench.state().lease_left_s) == (0.0, False, 0.0)


def test_a_trip_is_told_unasked(new_board):
    bench = tripped(new_board)
    bench.listen()
    bench.step()
    [(header, state)] = [(h, m) for h, m in bench.listen() if isinstance(m, StateEcho)]
    assert header.ack == 0 and state.tripped


def test_a_cool_box_does_not_clear_a_trip(new_board):
    bench = tripped(new_board)
    for pins in bench.run(60_000, air=20.0):
        assert_safe(pins)
    bench.greet()
    assert bench.state().tripped


@pytest.mark.parametrize("air", [42.01, 45.0, None, math.nan, -20.01])
def test_clearing_is_refused_while_the_air_is_warm_or_not_known(new_board, air):
    bench = tripped(new_board).air(air)
    assert is_error(bench.ask(ClearTrip()), ErrorCode.TRIPPED, OVER_TEMPERATURE)
    assert_safe(bench.step())


def test_clearing_is_refused_when_the_sample_is_old(new_board):
    bench = tripped(new_board).air(20.0)
    bench.run(3100, air=None)
    assert is_error(bench.ask(ClearTrip()), ErrorCode.TRIPPED, OVER_TEMPERATURE)


@pytest.mark.parametrize("air", [42.0, 41.99, -20.0])
def test_a_cleared_board_heats_again_only_by_a_new_command(new_board, air):
    bench = tripped(new_board).air(air)
    assert not bench.ask(ClearTrip()).tripped
    pins = bench.step(100)
    assert not pins.heater_relay and bench.state().heater_steps == 0
    assert bench.ask(HEAT).heater_steps == 20


def test_clearing_without_a_trip_changes_nothing(new_board):
    bench = heating(new_board)
    bench.air(44.0)
    assert bench.ask(ClearTrip()).heater_steps == 20


def test_heat_is_refused_while_tripped_and_so_is_the_rest_of_that_command(new_board):
    bench = tripped(new_board)
    assert is_error(bench.ask(replace(HEAT, heater_steps=1)), ErrorCode.TRIPPED, OVER_TEMPERATURE)
    assert bench.state().led_pct == 0
    assert bench.ask(replace(IDLE, led_pct=40, valve_pulse_s=1.0)).led_pct == 40
    assert bench.step().valve
    assert_safe(bench.pins)


def test_a_trip_can_come_back(new_board):
    bench = tripped(new_board).air(40.0)
    bench.ask(ClearTrip())
    bench.ask(HEAT)
    bench.air(45.0)
    assert not bench.state().tripped
    bench.air(45.0)
    assert bench.state().tripped


STOPS = [
    (EmergencyStop(), ReleaseStop(), TripCause.EMERGENCY_STOP),
    (Maintenance(), EndMaintenance(), TripCause.MAINTENANCE),
]
stops = pytest.mark.parametrize(("stop", "release", "cause"), STOPS)
FAN_SAFE = replace(CONFIG, fan_safe_on=True)
EVERYTHING = replace(HEAT, valve_pulse_s=5.0)


@stops
@pytest.mark.parametrize("config", [CONFIG, FAN_SAFE])
def test_a_stop_turns_everything_off_at_once_the_fan_too(new_board, config, stop, release, cause):
    bench = heating(new_board, EVERYTHING, config=config)
    pins = bench.run(1500)[-1]
    assert pins.heater_relay and pins.fan and pins.led and pins.valve
    state = bench.ask(stop)
    assert (state.trip_cause, state.heater_steps, state.led_pct) == (cause, 0, 0)
    assert not state.fan_on and not state.valve_open and state.cutoff_open and state.lease_left_s == 0.0
    assert_still(bench.step())


@stops
@pytest.mark.parametrize(
    ("field", "least"), [("heater_steps", 1), ("fan_on", True), ("led_pct", 1), ("valve_pulse_s", 0.1)]
)
def test_while_stopped_a_command_that_drives_anything_is_refused(
    new_board, stop, release, cause, field, least
):
    bench = heating(new_board)
    bench.ask(stop)
    asked = replace(IDLE, **{field: least})
    assert is_error(bench.ask(asked), ErrorCode.TRIPPED, cause)
    assert_still(bench.step(100))
    assert bench.ask(IDLE).lease_left_s == 10.0
    assert_still(bench.step(100))


@stops
def test_silence_and_the_end_of_every_lease_start_nothing_while_stopped(new_board, stop, release, cause):
    bench = heating(new_board, config=FAN_SAFE)
    bench.ask(stop)
    bench.ask(IDLE)
    for pins in bench.run(60_000, air=25.0) + bench.run(60_000, air=None):
        assert_still(pins)


@stops
@pytest.mark.parametrize("reset_cause", range(6))
def test_a_stop_survives_every_reset(new_board, reset_cause, stop, release, cause):
    bench = heating(new_board)
    bench.ask(stop)
    store = bench.board.persistent()
    again = BoardBench(new_board, FAN_SAFE, persistent=store, reset_cause=reset_cause)
    assert_still(again.step())
    assert_still(again.greet().air(25.0).step(100))
    assert again.state().trip_cause is cause


@stops
def test_an_over_temperature_during_a_stop_does_not_start_the_fan(new_board, stop, release, cause):
    bench = heating(new_board, config=FAN_SAFE)
    bench.ask(stop)
    state = bench.air(46.0).air(46.0).state()
    assert state.trip_cause is cause
    for pins in bench.run(5000, air=46.0):
        assert_still(pins)


@stops
def test_a_stop_during_an_over_temperature_turns_the_fan_off(new_board, stop, release, cause):
    bench = tripped(new_board)
    assert_safe(bench.step())
    assert bench.ask(stop).trip_cause is cause
    assert_still(bench.step())


@stops
def test_the_fan_cools_again_when_a_stop_ends_and_the_trip_stands(new_board, stop, release, cause):
    bench = tripped(new_board)
    bench.ask(stop)
    state = bench.ask(release)
    assert (state.trip_cause, state.fan_on) == (OVER_TEMPERATURE, True)
    assert_safe(bench.step())
    assert is_error(bench.ask(HEAT), ErrorCode.TRIPPED, OVER_TEMPERATURE)


@stops
@pytest.mark.parametrize("air", [25.0, 46.0, None])
def test_a_release_needs_no_air_and_starts_no_heat(new_board, stop, release, cause, air):
    bench = heating(new_board)
    bench.ask(stop)
    state = bench.air(air).ask(release)
    assert not state.tripped and state.heater_steps == 0 and not state.fan_on
    assert not any(pins.heater_relay or pins.fan or pins.led for pins in bench.run(2000))
    assert bench.ask(HEAT).heater_steps == 20


def test_each_stop_ends_by_its_own_request_alone(new_board):
    bench = heating(new_board)
    for stop, _, _ in STOPS:
        bench.ask(stop)
    assert bench.state().trip_cause is TripCause.EMERGENCY_STOP
    assert bench.ask(ClearTrip()).trip_cause is TripCause.EMERGENCY_STOP
    assert bench.ask(EndMaintenance()).trip_cause is TripCause.EMERGENCY_STOP
    bench.ask(Maintenance())
    assert bench.ask(ReleaseStop()).trip_cause is TripCause.MAINTENANCE
    assert bench.ask(ReleaseStop()).trip_cause is TripCause.MAINTENANCE
    assert_still(bench.step())
    assert not bench.ask(EndMaintenance()).tripped


def test_clearing_a_trip_during_a_stop_leaves_the_stop_alone(new_board):
    bench = tripped(new_board)
    bench.ask(EmergencyStop())
    assert is_error(bench.air(43.0).ask(ClearTrip()), ErrorCode.TRIPPED, TripCause.EMERGENCY_STOP)
    assert bench.air(40.0).ask(ClearTrip()).trip_cause is TripCause.EMERGENCY_STOP
    assert not bench.ask(ReleaseStop()).tripped


@pytest.mark.parametrize("config", [CONFIG, FAN_SAFE])
def test_a_damaged_store_may_have_held_a_stop_so_nothing_is_driven(new_board, config):
    bench = BoardBench(new_board, config, persistent=b"\x01\x02\x00\x00").greet().air(25.0)
    assert_still(bench.step())
    asked = replace(IDLE, fan_on=True)
    assert is_error(bench.ask(asked), ErrorCode.TRIPPED, TripCause.STORAGE_DAMAGED)
    assert bench.ask(ReleaseStop()).trip_cause is TripCause.STORAGE_DAMAGED
    assert not bench.ask(ClearTrip()).tripped
    assert bench.ask(asked).fan_on


# ---- the store


def test_the_store_has_the_documented_bytes(new_board):
    bench = BoardBench(new_board)
    assert bench.board.persistent() == b"\x01\x00" + crc16(b"\x01\x00").to_bytes(2, "big")
    bench = tripped(new_board)
    assert bench.board.persistent() == b"\x01\x01" + crc16(b"\x01\x01").to_bytes(2, "big")
    bench.ask(EmergencyStop())
    bench.ask(Maintenance())
    assert bench.board.persistent() == b"\x01\x0b" + crc16(b"\x01\x0b").to_bytes(2, "big")


@pytest.mark.parametrize("reset_cause", range(6))
def test_a_trip_survives_every_reset(new_board, reset_cause):
    store = tripped(new_board).board.persistent()
    bench = BoardBench(new_board, persistent=store, reset_cause=reset_cause)
    assert_safe(bench.step())
    bench.greet()
    assert bench.state().trip_cause is OVER_TEMPERATURE
    assert is_error(bench.air(25.0).ask(HEAT), ErrorCode.TRIPPED, OVER_TEMPERATURE)


def test_a_cleared_trip_stays_cleared(new_board):
    bench = tripped(new_board).air(40.0)
    bench.ask(ClearTrip())
    assert not BoardBench(new_board, persistent=bench.board.persistent()).greet().state().tripped


@pytest.mark.parametrize("blank", BLANK)
def test_a_blank_store_holds_no_trip(new_board, blank):
    assert not BoardBench(new_board, persistent=blank).greet().state().tripped


def test_a_store_with_every_latch_is_whole(new_board):
    store = b"\x01\x0f" + crc16(b"\x01\x0f").to_bytes(2, "big")
    bench = BoardBench(new_board, persistent=store).greet().air(25.0)
    assert bench.state().trip_cause is TripCause.EMERGENCY_STOP
    assert bench.ask(ReleaseStop()).trip_cause is TripCause.MAINTENANCE
    assert bench.ask(EndMaintenance()).trip_cause is TripCause.STORAGE_DAMAGED
    assert not bench.ask(ClearTrip()).tripped


def test_every_damaged_store_is_a_trip(new_board):
    good = BoardBench(new_board).board.persistent()
    flipped = [
        bytes(b ^ (1 << bit if k == at else 0) for k, b in enumerate(good))
        for at in range(4)
        for bit in range(8)
    ]
    torn = [good[:k] + b"\xff" * (4 - k) for k in range(1, 4)] + [bytes(4), good[:3], good + b"\0"]
    unknown_latch = b"\x01\x10" + crc16(b"\x01\x10").to_bytes(2, "big")
    unknown_layout = b"\x02\x00" + crc16(b"\x02\x00").to_bytes(2, "big")
    for store in [*flipped, *torn, unknown_latch, unknown_layout]:
        state = BoardBench(new_board, persistent=store).greet().state()
        assert state.trip_cause is TripCause.STORAGE_DAMAGED, store.hex()


@pytest.mark.parametrize("temp_trip_c", [0.0, 3.0, 30.0, 100.0])
def test_the_limit_is_the_configured_one(new_board, temp_trip_c):
    bench = BoardBench(new_board, replace(CONFIG, temp_trip_c=temp_trip_c)).greet()
    bench.air(min(temp_trip_c, 80.01) - 0.01).air(min(temp_trip_c, 80.01) - 0.01)
    assert not bench.state().tripped
    bench.air(temp_trip_c).air(temp_trip_c)
    assert bench.state().tripped is (temp_trip_c < 80)
    assert isinstance(bench.ask(CommandMessage(0, False, 0, 0.0, False, 1.0)), StateEcho)
