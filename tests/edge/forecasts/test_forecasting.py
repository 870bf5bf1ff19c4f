"""The forecasts' part of a tick, on the estimator's own history."""

import math
from dataclasses import replace

import pytest
from forecast_rig import STEP_S, BrokenForecast, RampPredictor, columns

from edge.bundle.trial import rival_rows
from edge.config.settings import EstimatorSettings
from edge.core.messages import Command, Decision, Reading, ReadingQuality
from edge.forecasts.conformal import Interval, Intervals
from edge.forecasts.forecasting import Forecasting
from edge.models.persistence import Persistence
from edge.tick.estimator import Estimator

INTERVALS = Intervals((Interval("ramp", "1", 5, 0.5, 100, "interpolation"),))
HELD = Decision(Command(0.5), "rules")


class WarmingRig:
    """A box that warms by 0.01 K a minute at half duty, and an estimator that watches it."""

    def __init__(self, forecasting):
        self.forecasting = forecasting
        self.estimator = Estimator(EstimatorSettings(), Persistence(STEP_S), STEP_S, 21.0)
        self.ticks = 0

    def tick(self, decision=HELD, driven=HELD.command, confirmed=True, passed=1):
        self.ticks += passed
        now = STEP_S * self.ticks
        reading = Reading("temp_air", 20.0 + 0.01 * self.ticks, now, ReadingQuality.GOOD)
        self.estimator.update({"temp_air": reading}, now, 1.7e9 + now)
        self.estimator.record_sent(driven)
        return self.forecasting.tick(self.estimator.history(), decision, driven, confirmed)

    def run(self, ticks):
        return [self.tick() for _ in range(ticks)][-1]


def ramp(**changes):
    return RampPredictor(gain_k=0.02, **changes)


def test_after_an_hour_of_ticks_every_forecast_has_a_skill():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": ramp(), "pbm": ramp(drift_k=0.5)}, INTERVALS))
    made, skill = rig.run(60)
    assert (set(made), skill) == ({"ramp", "pbm"}, ())
    _, skill = rig.run(1)
    assert [(row.predictor, row.horizon_min) for row in skill] == [
        (name, minutes) for name in ("pbm", "ramp") for minutes in (1, 5, 15, 30, 60)
    ]
    hour = next(row for row in skill if (row.predictor, row.horizon_min) == ("ramp", 60))
    # persistence is 0.6 K off after an hour, the PBM 30 K, the ramp what the estimator lags behind
    assert hour.mae_k < 0.1
    assert hour.against_persistence == pytest.approx(1.0 - hour.mae_k / 0.6)
    assert hour.against_pbm is not None and hour.against_pbm > 0.99


def test_intervals_come_with_the_forecasts_and_follow_the_errors():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS))
    assert rig.tick()[0]["ramp"].half_widths == {5: 0.5}
    made, skill = rig.run(61)
    assert made["ramp"].half_widths[5] < 0.5
    assert next(row.covered for row in skill if row.horizon_min == 5) == 1.0


def test_a_forecast_follows_the_plan():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": RampPredictor()}))
    heated, _ = rig.tick(Decision(Command(0.5), "MPC", plan=((0.5, 0.0), (1.0, 0.0))))
    held, _ = WarmingRig(Forecasting(STEP_S, {"ramp": RampPredictor()})).tick()
    assert heated["ramp"].temps[60] - held["ramp"].temps[60] == pytest.approx(59 * 0.5)


def test_a_rival_is_scored_and_does_not_forecast():
    active, rivals = {"ramp": ramp()}, {"ramp": ramp(drift_k=0.1, version="2")}
    rig = WarmingRig(Forecasting(STEP_S, active, INTERVALS, rivals))
    made, skill = rig.run(61)
    assert set(made) == {"ramp"}
    assert {row.predictor for row in skill} == {"ramp", "ramp.rival"}
    rows = rival_rows(rig.forecasting.state, active, rivals)
    assert [(row.model, row.horizon_s, row.count) for row in rows] == [
        ("ramp", 60.0 * minutes, 1) for minutes in (1, 5, 15, 30, 60)
    ]
    assert rows[-1].rival_k - rows[-1].active_k == pytest.approx(6.0, abs=0.2)  # 60 times 0.1 K


def test_other_predictors_take_over_without_waiting_for_an_hour():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS))
    rig.run(70)
    rig.forecasting.serve({"ramp": ramp(version="2")})
    made, skill = rig.tick()
    assert made["ramp"].half_widths == {}
    assert {(row.version, row.scored) for row in skill} == {("2", 1)}


def test_a_trial_begins_anew_when_the_bundles_are_exchanged_and_goes_on_after_a_restart():
    active, rivals = {"ramp": ramp()}, {"ramp": ramp(version="2")}
    rig = WarmingRig(Forecasting(STEP_S, active, INTERVALS, rivals))
    rig.run(62)
    again = Forecasting(STEP_S, active, INTERVALS, rivals, rig.forecasting.state)
    assert {row.count for row in rival_rows(again.state, active, rivals)} == {2}
    rig.forecasting.serve(active, INTERVALS, rivals)
    assert rival_rows(rig.forecasting.state, active, rivals) == ()
    _, skill = rig.tick()
    assert {(row.predictor, row.scored) for row in skill} == {("ramp", 3), ("ramp.rival", 1)}


def test_the_skill_goes_on_from_the_process_before():
    before = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS))
    before.run(65)
    after = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS, state=before.forecasting.state))
    _, skill = after.tick()
    assert {row.scored for row in skill} == {5}
    _, skill = after.run(60)
    assert {row.scored for row in skill} == {6}


def test_missed_ticks_cost_an_hour_of_scores_and_nothing_else():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS))
    rig.run(65)
    made, skill = rig.tick(passed=3)
    assert made["ramp"].temps and {row.scored for row in skill} == {5}
    _, skill = rig.run(59)
    assert {row.scored for row in skill} == {5}
    _, skill = rig.run(1)
    assert {row.scored for row in skill} == {6}


@pytest.mark.parametrize("history", [columns([]), columns([20.0], duties=[math.nan])])
def test_a_history_with_nothing_in_it_is_no_error(history):
    made, skill = Forecasting(STEP_S, {"ramp": RampPredictor()}).tick(history, HELD, HELD.command, True)
    assert skill == () and set(made) <= {"ramp"}


def test_without_predictors_there_is_nothing_to_tell():
    assert WarmingRig(Forecasting(STEP_S, {})).run(61) == ({}, ())


def test_a_predictor_that_raises_leaves_the_others_their_tick():
    rig = WarmingRig(Forecasting(STEP_S, {"bad": BrokenForecast(MemoryError()), "ramp": ramp()}))
    made, skill = rig.run(61)
    assert (made["bad"].temps, made["bad"].reason) == ({}, "MemoryError: ")
    assert {row.predictor for row in skill} == {"ramp"}


def test_the_state_does_not_change_under_the_reader():
    rig = WarmingRig(Forecasting(STEP_S, {"ramp": ramp()}, INTERVALS))
    rig.run(61)
    kept = rig.forecasting.state
    copied = replace(kept, pairs=dict(kept.pairs), widths=dict(kept.widths))
    rig.run(1)
    assert kept == copied and rig.forecasting.state != kept
