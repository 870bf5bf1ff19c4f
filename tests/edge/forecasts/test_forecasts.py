import math

import numpy as np
import pytest
from forecast_rig import STEP_S, BrokenForecast, RampPredictor, columns

from edge.core.horizons import STEPS_MAX, steps_of
from edge.core.messages import Command
from edge.forecasts.forecasting import forecasts, planned_inputs
from edge.forecasts.scorer import ahead_of, roll
from edge.models.arx_file import read_arx

NOTHING = np.zeros((1, 2))


def uncalibrated(name, version, horizons_min):
    return {}


def forecast(predictor, history=None, planned=NOTHING, step_s=STEP_S, half_widths=uncalibrated):
    history = columns([20.0, 21.0]) if history is None else history
    return forecasts({"x": predictor}, history, planned, step_s, half_widths)["x"]


@pytest.mark.parametrize(
    ("step_s", "steps"),
    [
        (60.0, {1: 1, 5: 5, 15: 15, 30: 30, 60: 60}),
        (36.0, {5: 8, 15: 25, 30: 50, 60: 100}),  # 1 min is 2 steps of 36 s and 20 % off
        (35.0, {5: 9, 15: 26, 30: 51}),  # 60 min would be 103 steps
        (10.0, {1: 6, 5: 30, 15: 90}),
        (7.0, {1: 9, 5: 43}),
        (1.0, {1: 60}),
        (600.0, {30: 3, 60: 6}),  # 15 min is 2 steps of 10 min and a third off
        (7200.0, {}),
    ],
)
def test_a_horizon_is_told_where_whole_steps_come_near_it(step_s, steps):
    assert steps_of(step_s) == steps
    assert all(count <= STEPS_MAX for count in steps.values())


def test_a_forecast_holds_the_temperature_at_each_horizon():
    # 21 °C and 0.5 K a minute
    made = forecast(RampPredictor(), planned=np.array([[0.5, 0.0]]))
    assert made.temps == {1: 21.5, 5: 23.5, 15: 28.5, 30: 36.0, 60: 51.0}
    assert (made.reason, made.outside, made.half_widths) == ("", None, {})


def test_the_last_planned_input_is_held():
    # two minutes at full duty, then a quarter for 58
    made = forecast(RampPredictor(), planned=np.array([[1.0, 0.0], [1.0, 0.0], [0.25, 1.0]]))
    assert made.temps[60] == 21.0 + 2.0 + 58 * 0.25


def test_a_plan_longer_than_an_hour_is_cut():
    assert forecast(RampPredictor(), planned=np.ones((500, 2))).temps[60] == 81.0


def test_each_predictor_is_asked_once_for_all_horizons():
    ramp = RampPredictor()
    forecast(ramp)
    assert [controls.shape for _, controls, _ in ramp.calls] == [(1, 60, 2)]


@pytest.mark.parametrize(
    ("predictor", "reason"),
    [
        (BrokenForecast(ValueError("no twin")), "ValueError: no twin"),
        (BrokenForecast(np.full((1, 60), math.nan)), "not a number after step 1"),
        (BrokenForecast(np.array([[20.0] * 59 + [math.inf]])), "not a number after step 60"),
        (BrokenForecast(np.zeros((1, 59))), "shape (1, 59), not (1, 60)"),
        (BrokenForecast(np.zeros(60)), "shape (60,), not (1, 60)"),
        (BrokenForecast("warm"), "ValueError: could not convert string to float: 'warm'"),
        (RampPredictor(rows_needed=3), "2 of 3 rows of history"),
        (RampPredictor(step_s=10.0), "made for steps of 10 s"),
        (RampPredictor(step_s=60.1), "made for steps of 60.1 s"),
    ],
)
def test_a_predictor_that_fails_is_a_value_with_its_reason(predictor, reason):
    made = forecasts(
        {"bad": predictor, "good": RampPredictor()}, columns([20.0, 21.0]), NOTHING, STEP_S, uncalibrated
    )
    assert (made["bad"].temps, made["bad"].reason) == ({}, reason)
    assert made["good"].temps[60] == 21.0


def test_a_history_that_is_just_long_enough_is_enough():
    assert forecast(RampPredictor(rows_needed=2)).temps


def test_half_widths_are_those_of_the_name_version_and_horizons():
    asked = []

    def half_widths(name, version, horizons_min):
        asked.append((name, version, tuple(horizons_min)))
        return {1: 0.2}

    assert forecast(RampPredictor(version="v7"), half_widths=half_widths).half_widths == {1: 0.2}
    assert asked == [("x", "v7", (1, 5, 15, 30, 60))]


@pytest.mark.parametrize(
    ("column", "limits", "beyond"),
    [
        # it starts at 21 °C, in a room of 21 °C, and gains 0.5 K a minute: 51 °C after an hour
        ("temp_air_c", (21.0, 51.0), False),
        ("temp_air_c", (21.0, 50.999), True),
        ("temp_ambient_c", (21.1, 25.0), True),
        ("heater_duty", (0.0, 0.4), True),
        ("fan_on", (1.0, 1.0), True),
        ("co2_ppm", (0.0, 0.0), False),  # no input of a rollout
    ],
)
def test_a_validity_box_flags_what_leaves_it(column, limits, beyond):
    ramp = RampPredictor()
    ramp.validity = {column: limits}
    assert forecast(ramp, planned=np.array([[0.5, 0.0]])).outside is beyond


def test_the_packaged_arx_knows_its_box():
    history = columns(np.full(20, 22.0))
    assert forecast(read_arx(), history).outside is True  # the room of 21 °C is below it
    history["temp_ambient"][:] = 21.8
    assert forecast(read_arx(), history).outside is False
    assert forecast(read_arx(), history, planned=np.array([[1.0, 0.0]])).outside is True


def test_where_no_horizon_fits_the_step_nothing_is_forecast():
    assert forecasts({"x": RampPredictor()}, columns([20.0]), NOTHING, 7200.0, uncalibrated) == {}


def test_the_room_stays_as_it_is_and_time_goes_on():
    history = columns([20.0, 21.0])
    ahead = ahead_of(history, 3, STEP_S)
    assert ahead["temp_ambient"].tolist() == [21.0, 21.0, 21.0]
    assert (ahead["utc"] - history["utc"][-1]).tolist() == [0.0, 60.0, 120.0]
    assert "offset" not in ahead and "heater_duty" not in ahead and "temp_air_measured" not in ahead


def test_the_packaged_arx_forecasts_from_a_history_of_the_estimator():
    history = columns(np.full(20, 21.5), duties=np.append(np.zeros(19), np.nan))
    heated = roll(read_arx(), history, np.tile([1.0, 0.0], (60, 1)), STEP_S).temps
    assert heated is not None and heated[-1] > heated[0] > 21.0


@pytest.mark.parametrize(
    ("plan", "used"),
    [
        ((), [[0.5, 0.0]]),
        (((0.5, 0.0), (0.6, 1.0)), [[0.5, 0.0], [0.6, 1.0]]),
        (((0.55, 0.0), (0.6, 1.0)), [[0.5, 0.0]]),  # safety or a person changed the heater
        (((0.5, 1.0), (0.6, 1.0)), [[0.5, 0.0]]),  # ... or the fan
        (((math.nan, 0.0), (0.6, 1.0)), [[0.5, 0.0]]),
    ],
)
def test_a_plan_counts_while_it_is_what_the_board_drives(plan, used):
    assert planned_inputs(Command(heater_duty=0.5), plan).tolist() == used
