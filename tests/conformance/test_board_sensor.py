"""Without an air temperature to trust there is no heat."""

import math
from dataclasses import replace

import pytest
from board_bench import CONFIG, HEAT, IDLE, BoardBench, heating

from firmware_protocol.messages import HeaterOffCause, Quality, SensorReport

WIDE = replace(CONFIG, temp_trip_c=100.0)  # so that only the sensor's own limits are in play
NO_NUMBER = [None, math.nan, math.inf, -math.inf, 1e30, -1e30, 655.35, -327.68]
OUT_OF_RANGE = [-20.01, 80.01, -50.0, 150.0, 150.01]
NOT_GOOD = [(value, 0) for value in NO_NUMBER + OUT_OF_RANGE]
NOT_GOOD += [(25.0, quality) for quality in (1, 2, 3, 4, 5, 255, 256, -1)] + [(None, 3), (math.nan, 4)]


def report_of(bench: BoardBench) -> SensorReport:
    """The next report."""
    bench.listen()
    bench.step(1000)
    return next(m for _, m in bench.listen() if isinstance(m, SensorReport))


@pytest.mark.parametrize(("value", "quality"), NOT_GOOD)
def test_a_sample_that_is_not_good_ends_heat_at_once(new_board, value, quality):
    bench = heating(new_board, config=WIDE)
    bench.run(1000)
    assert bench.pins.heater_relay and bench.pins.fan
    bench.air(value, quality)
    pins, state = bench.step(), bench.state()
    assert not pins.heater_relay and state.heater_steps == 0
    assert not pins.fan and pins.cutoff_open
    assert state.heater_off_cause is HeaterOffCause.SENSOR_FAULT
    assert pins.led == 0.6 and not state.tripped


@pytest.mark.parametrize("value", [-20.0, -19.99, 0.0, 25, 79.99, 80.0])
def test_heat_is_allowed_to_the_edges_of_the_range(new_board, value):
    bench = heating(new_board, config=WIDE)
    bench.air(value)
    assert bench.state().heater_steps == 20


@pytest.mark.parametrize("start_ms", [0, 2**32 - 1500, 2**32 - 3001])
def test_a_sample_lasts_three_seconds(new_board, start_ms):
    bench = heating(new_board, start_ms=start_ms)
    bench.now_ms += 3000
    assert bench.state().heater_steps == 20
    bench.now_ms += 1
    assert (bench.state().heater_steps, bench.state().heater_off_cause.name) == (0, "SENSOR_FAULT")


def test_other_samples_do_not_keep_the_air_fresh(new_board):
    bench = heating(new_board)
    for _ in range(31):
        bench.now_ms += 100
        bench.board.sample({"temp_ambient_c": (21.0, 0), "rel_humidity_pct": (50.0, 0)}, bench.now_ms)
    assert bench.state().heater_steps == 0


def test_heat_needs_a_command_received_after_the_air_became_good(new_board):
    bench = heating(new_board)
    bench.air(None)
    assert bench.ask(HEAT).heater_steps == 0
    bench.air(25.0)
    assert bench.state().heater_steps == 0
    assert not any(pins.heater_relay for pins in bench.run(2000))
    assert bench.ask(HEAT).heater_steps == 20


def test_a_glitch_between_two_steps_is_not_overlooked(new_board):
    bench = heating(new_board)
    bench.air(math.nan)
    bench.air(25.0)
    assert bench.state().heater_steps == 0


def test_no_sample_means_no_heat(new_board):
    bench = BoardBench(new_board).greet()
    assert bench.ask(HEAT).heater_off_cause is HeaterOffCause.SENSOR_FAULT
    assert not any(pins.heater_relay for pins in bench.run(5000, air=None))


def test_light_and_water_go_on_without_the_air_sensor(new_board):
    bench = heating(new_board)
    bench.air(None)
    assert bench.ask(replace(IDLE, led_pct=30, valve_pulse_s=1.0)).led_pct == 30
    assert bench.step().valve


@pytest.mark.parametrize("fan_safe_on", [False, True])
def test_a_dead_sensor_leaves_the_fan_in_its_configured_state(new_board, fan_safe_on):
    bench = heating(
        new_board, replace(HEAT, fan_on=not fan_safe_on), config=replace(CONFIG, fan_safe_on=fan_safe_on)
    )
    assert bench.step().fan is not fan_safe_on
    bench.air(None)
    assert bench.step().fan is fan_safe_on


def test_an_old_sample_is_not_fresh_again_when_the_clock_comes_round(new_board):
    bench = heating(new_board)
    bench.run(3100, air=None)
    bench.now_ms += 2**32 - 3100 + 50
    assert bench.ask(HEAT).heater_steps == 0


# ---- what the report says


@pytest.mark.parametrize(
    ("value", "quality", "told", "told_quality"),
    [
        (25.004, 0, 25.0, "GOOD"), (25.006, 0, 25.01, "GOOD"), (-0.004, 0, 0.0, "GOOD"),
        (None, 0, None, "FAULT"), (math.nan, 0, None, "FAULT"), (None, 4, None, "ABSENT"),
        (math.inf, 0, None, "RANGE"), (-math.inf, 3, None, "FAULT"), (150.01, 0, None, "RANGE"),
        (150.0, 0, 150.0, "RANGE"), (-20.01, 0, -20.01, "RANGE"), (80.01, 0, 80.01, "RANGE"),
        (25.0, 1, 25.0, "STALE"), (25.0, 99, 25.0, "FAULT"), (25.0, -1, 25.0, "FAULT"),
    ],
)  # fmt: skip
def test_the_report_tells_the_air_and_why_it_is_not_good(new_board, value, quality, told, told_quality):
    report = report_of(BoardBench(new_board).air(value, quality))
    assert (report.temp_air_c, report.temp_air_quality.name) == (told, told_quality)


@pytest.mark.parametrize(
    ("signal", "last_good", "first_bad"),
    [
        ("rel_humidity_pct", 100.0, 100.01), ("rel_humidity_pct", 0.0, -0.01), ("co2_ppm", 10000, 10001),
        ("co2_ppm", 0, -1), ("light", 1.0, 1.0001), ("light", 0.0, -0.0001), ("soil_moisture", 1.0, 1e300),
        ("tank_level", 1.0, -1e300), ("tank_level", 0.0, -0.0001), ("soil_moisture", 0.0, -0.0001),
        ("soil_moisture", 1.0, 1.0001), ("tank_level", 1.0, 1.0001), ("temp_ambient_c", 150.0, 150.01),
        ("temp_ambient_c", -50.0, -50.01),
        ("rel_humidity_pct", 50.0, 655.35), ("temp_ambient_c", 0.0, -327.68),
    ],
)  # fmt: skip
def test_a_number_that_the_wire_cannot_carry_is_none(new_board, signal, last_good, first_bad):
    quality = {"rel_humidity_pct": "rel_humidity_quality", "co2_ppm": "co2_quality", "temp_ambient_c":
               "temp_ambient_quality"}.get(signal, f"{signal}_quality")  # fmt: skip
    bench = BoardBench(new_board)
    bench.board.sample({signal: (last_good, 0)}, bench.now_ms)
    report = report_of(bench)
    assert (getattr(report, signal), getattr(report, quality)) == (last_good, Quality.GOOD)
    bench.board.sample({signal: (first_bad, 0)}, bench.now_ms)
    report = report_of(bench)
    assert (getattr(report, signal), getattr(report, quality)) == (None, Quality.RANGE)


def test_what_was_never_sampled_is_absent(new_board):
    report = report_of(BoardBench(new_board))
    told = [getattr(report, name) for name in SensorReport.__dataclass_fields__ if name != "board_ms"]
    assert told == [None, Quality.ABSENT] * (len(told) // 2)


def test_an_old_sample_is_stale_and_keeps_its_number(new_board):
    bench = BoardBench(new_board).air(25.0)
    assert [report_of(bench).temp_air_quality.name for _ in range(4)] == ["GOOD", "GOOD", "GOOD", "STALE"]
    assert report_of(bench).temp_air_c == 25.0


@pytest.mark.parametrize(
    ("rpm", "quality", "told"),
    [(1200, 0, 1200), (0, 0, 0), (65534, 0, 65534), (65535, 0, None), (-1, 0, None), (1200, 3, None)],
)
def test_the_state_tells_the_fan_speed_when_it_is_good(new_board, rpm, quality, told):
    bench = BoardBench(new_board).greet()
    assert bench.state().fan_rpm is None
    bench.board.sample({"fan_rpm": (rpm, quality)}, bench.now_ms)
    assert bench.state().fan_rpm == told
