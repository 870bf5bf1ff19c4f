import math

import numpy as np
import pytest
from forecast_rig import STEP_S, BrokenForecast, RampPredictor, columns, window

from edge.forecasts.scorer import PERSISTENCE, Scorer

TICKS = 70
DUTIES = np.where(np.arange(TICKS) % 3 == 0, 0.25, 0.0)
TRUTH = 20.0 + np.concatenate([[0.0], np.cumsum(DUTIES[:-1])])  # a box that Ramp() describes exactly


def run(scorer, predictors, history, ticks=TICKS, known=lambda tick: True):
    """Scores by tick, the first tick being 1."""
    return {
        tick: scorer.observe(predictors, window(history, tick), known(tick)) for tick in range(1, ticks + 1)
    }


def test_an_hour_after_the_start_every_horizon_of_it_is_scored():
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor()}, columns(TRUTH, DUTIES))
    assert all(scores[tick] == [] for tick in range(1, 61))
    assert [(one.predictor, one.horizon_min) for one in scores[61]] == [
        *((PERSISTENCE, minutes) for minutes in (1, 5, 15, 30, 60)),
        *(("ramp", minutes) for minutes in (1, 5, 15, 30, 60)),
    ]


def test_a_perfect_model_has_no_residual_whatever_the_inputs_did():
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor()}, columns(TRUTH, DUTIES))
    assert all(abs(one.residual_k) < 1e-9 for s in scores.values() for one in s if one.predictor == "ramp")


def test_residuals_are_measured_minus_forecast():
    # drifting 0.1 K a minute too warm: -0.1 K per minute of horizon
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor(drift_k=0.1)}, columns(TRUTH, DUTIES))
    of_model = {one.horizon_min: one.residual_k for one in scores[61] if one.predictor == "ramp"}
    assert of_model == {minutes: pytest.approx(-0.1 * minutes) for minutes in (1, 5, 15, 30, 60)}


def test_persistence_is_the_measurement_at_the_start():
    measured = TRUTH + 0.3 * (np.arange(TICKS) == 0)  # the first reading is 0.3 K too warm
    scores = run(Scorer(STEP_S), {}, columns(TRUTH, DUTIES, measured))
    held = {one.horizon_min: one.residual_k for one in scores[61]}
    assert held == {m: pytest.approx(TRUTH[m] - 20.3) for m in (1, 5, 15, 30, 60)}


def test_one_rollout_per_predictor_and_tick():
    ramp = RampPredictor()
    run(Scorer(STEP_S), {"ramp": ramp}, columns(TRUTH, DUTIES))
    assert len(ramp.calls) == TICKS - 60


def test_a_start_is_as_it_was_known_then_and_not_as_later_measurements_corrected_it():
    history = columns(TRUTH, DUTIES)
    scorer, ramp = Scorer(STEP_S), RampPredictor()
    for tick in range(1, 61):
        scorer.observe({"ramp": ramp}, window(history, tick), True)
    history["temp_air"][:4] += 5.0
    scored = scorer.observe({"ramp": ramp}, window(history, 61), True)
    assert all(abs(one.residual_k) < 1e-9 for one in scored if one.predictor == "ramp")
    assert history["temp_air"][0] == 25.0  # and the history itself is left alone


def test_a_predictor_sees_no_row_after_the_start():
    history, ramp = columns(TRUTH, DUTIES), RampPredictor()
    run(Scorer(STEP_S), {"ramp": ramp}, history, ticks=61)
    seen, controls, ahead = ramp.calls[0]
    assert {len(column) for column in seen.values()} == {1}
    assert controls[0, :, 0].tolist() == DUTIES[:60].tolist()
    assert ahead["temp_ambient"].tolist() == [21.0] * 60


def test_a_horizon_without_a_good_reading_at_its_end_is_left_out():
    measured = np.where(np.arange(TICKS) == 15, math.nan, TRUTH)
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor()}, columns(TRUTH, DUTIES, measured))
    assert {one.horizon_min for one in scores[61]} == {1, 5, 30, 60}


def test_a_start_without_a_good_reading_is_skipped_and_counted():
    measured = np.where(np.arange(TICKS) == 0, math.nan, TRUTH)
    scorer = Scorer(STEP_S)
    scores = run(scorer, {"ramp": RampPredictor()}, columns(TRUTH, DUTIES, measured), ticks=62)
    assert (scores[61], len(scores[62]), scorer.skipped) == ([], 10, 1)


def test_inputs_that_were_not_confirmed_end_what_is_under_way():
    scorer = Scorer(STEP_S)
    history = columns(np.full(100, 20.0))
    scores = run(scorer, {"ramp": RampPredictor()}, history, 92, known=lambda tick: tick != 30)
    # 29 starts before it; the first after it is that of tick 31, and 60 later it is scored
    assert scorer.skipped == 29
    assert min(tick for tick, scored in scores.items() if scored) == 91


def an_order_between_the_ticks(history):
    history["heater_duty"][29] = 0.9
    return window(history, 31)


@pytest.mark.parametrize(
    "then",
    [
        an_order_between_the_ticks,
        lambda history: window(history, 32),
        lambda history: window(history, 36),
        lambda history: columns([22.0], start_s=9000.0),
    ],
    ids=["an input changed within its step", "a missed tick", "five missed ticks", "a history begun anew"],
)
def test_what_is_under_way_ends(then):
    scorer, history = Scorer(STEP_S), columns(TRUTH, DUTIES)
    for tick in range(1, 31):
        scorer.observe({}, window(history, tick), True)
    scorer.observe({}, then(history), True)
    assert scorer.skipped == 30


def test_a_history_without_rows_or_inputs_is_nothing_to_score():
    scorer = Scorer(STEP_S)
    assert scorer.observe({"ramp": RampPredictor()}, columns([]), True) == []
    assert scorer.observe({"ramp": RampPredictor()}, columns([20.0], duties=[math.nan]), True) == []


@pytest.mark.parametrize(
    "bad", [BrokenForecast(RuntimeError("x")), BrokenForecast(np.full((1, 60), math.nan))]
)
def test_a_predictor_that_fails_is_not_scored_and_the_others_are(bad):
    scores = run(Scorer(STEP_S), {"bad": bad, "ramp": RampPredictor()}, columns(TRUTH, DUTIES))
    assert {one.predictor for one in scores[61]} == {PERSISTENCE, "ramp"}


def test_a_predictor_with_more_lags_is_scored_once_they_are_there():
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor(rows_needed=4)}, columns(TRUTH, DUTIES))
    assert min(t for t, scored in scores.items() if any(s.predictor == "ramp" for s in scored)) == 64


def test_scoring_goes_on_when_the_history_is_full():
    ticks, duties = 200, np.full(200, 0.01)
    truth = 20.0 + 0.01 * np.arange(ticks)
    scores = run(Scorer(STEP_S), {"ramp": RampPredictor(rows_needed=10)}, columns(truth, duties), ticks)
    assert all(len(scores[tick]) == 10 for tick in range(70, ticks + 1))
    assert all(abs(s.residual_k) < 1e-9 for s in scores[ticks] if s.predictor == "ramp")


def test_at_a_step_that_no_horizon_fits_nothing_is_scored():
    assert (
        run(Scorer(7200.0), {"ramp": RampPredictor(step_s=7200.0)}, columns(TRUTH, step_s=7200.0))[TICKS]
        == []
    )
