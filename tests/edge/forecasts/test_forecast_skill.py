import json
from dataclasses import replace

import pytest
from forecast_rig import STEP_S, RampPredictor

from edge.bundle.trial import rival_rows
from edge.core.errors import DataError
from edge.forecasts.conformal import Interval, Intervals
from edge.forecasts.scorer import PERSISTENCE, ScoredForecast
from edge.forecasts.skill import SkillState, half_widths, skills, update_skill
from edge.state.codecs import decode_skill, encode_skill

NONE = Intervals()
CALIBRATED = Intervals((Interval("arx", "1", 5, 0.5, 100, "interpolation"),))
ARX = {"arx": RampPredictor()}


def scored(name, residual_k, horizon_min=5, version="1"):
    return ScoredForecast(name, version, horizon_min, residual_k, 25.0)


def tick(state, persistence_k=1.0, intervals=NONE, version="1", **residuals_k):
    """The state after one tick with these residuals at 5 min."""
    found = [scored(name.replace("_", "."), value, version=version) for name, value in residuals_k.items()]
    return update_skill(state, [scored(PERSISTENCE, persistence_k), *found], intervals, STEP_S)


def only(state, predictors=ARX):
    (row,) = skills(state, predictors)
    return row


def test_skill_is_one_minus_the_ratio_of_the_mean_errors():
    # arx: 0.1 and 0.3 K; persistence: 1 K; pbm: 0.5 and 1.5 K
    state = tick(tick(SkillState(), arx=0.1, pbm=0.5), arx=-0.3, pbm=-1.5)
    row = only(state)
    assert (row.predictor, row.version, row.horizon_min, row.scored) == ("arx", "1", 5, 2)
    assert row.mae_k == pytest.approx(0.2)
    assert row.against_persistence == pytest.approx(0.8)
    assert row.against_pbm == pytest.approx(0.8)
    assert (row.half_width_k, row.covered) == (None, None)


def test_without_the_pbm_there_is_no_skill_against_it():
    assert only(tick(SkillState(), arx=0.1)).against_pbm is None


def test_the_pbm_is_not_held_against_itself():
    assert only(tick(SkillState(), pbm=0.1), {"pbm": RampPredictor()}).against_pbm is None


def test_a_reference_without_error_gives_no_skill():
    assert only(tick(SkillState(), persistence_k=0.0, arx=0.1)).against_persistence is None


def test_errors_are_compared_on_the_same_forecasts_alone():
    # the PBM gave nothing at the second tick: only the first one counts against it
    row = only(tick(tick(SkillState(), arx=0.1, pbm=0.2), arx=0.9))
    assert row.against_pbm == pytest.approx(0.5)
    assert row.mae_k == pytest.approx(0.5)


def test_without_a_good_start_nothing_changes():
    state = tick(SkillState(), arx=0.1)
    assert update_skill(state, [], NONE, STEP_S) is state


def test_a_day_counts_alike_and_then_older_errors_fade():
    state, step_s = SkillState(), 21600.0  # a quarter of a day
    for error in (1.0, 2.0, 3.0, 4.0):
        state = update_skill(state, [scored(PERSISTENCE, 1.0), scored("arx", error)], NONE, step_s)
    assert only(state).mae_k == pytest.approx(2.5)
    state = update_skill(state, [scored(PERSISTENCE, 1.0), scored("arx", 6.5)], NONE, step_s)
    assert only(state).mae_k == pytest.approx(2.5 + 0.25 * (6.5 - 2.5))
    assert only(state).scored == 5


def test_a_new_version_begins_anew():
    state = tick(tick(SkillState(), arx=5.0), arx=0.1, version="2")
    assert skills(state, ARX) == ()
    row = only(state, {"arx": RampPredictor(version="2")})
    assert (row.scored, row.mae_k) == (1, pytest.approx(0.1))


def test_predictors_that_serve_no_more_are_not_told():
    assert skills(tick(SkillState(), arx=0.1), {}) == ()


def test_rows_come_by_predictor_and_horizon():
    found = [scored(n, 0.1, m) for n in ("pbm", "arx", PERSISTENCE) for m in (60, 5)]
    rows = skills(
        update_skill(SkillState(), found, NONE, STEP_S), {"pbm": RampPredictor(), "arx": RampPredictor()}
    )
    assert [(r.predictor, r.horizon_min) for r in rows] == [("arx", 5), ("arx", 60), ("pbm", 5), ("pbm", 60)]


# intervals


def test_a_calibrated_interval_is_told_before_anything_was_scored():
    assert half_widths(SkillState(), CALIBRATED, "arx", "1", (1, 5)) == {5: 0.5}
    assert half_widths(SkillState(), CALIBRATED, "arx", "2", (1, 5)) == {}


@pytest.mark.parametrize(("residual_k", "inside"), [(0.5, 1.0), (-0.5, 1.0), (0.501, 0.0), (-0.501, 0.0)])
def test_coverage_counts_the_measurements_inside(residual_k, inside):
    row = only(tick(SkillState(), intervals=CALIBRATED, arx=residual_k))
    assert row.covered == inside
    assert (row.half_width_k < 0.5) == bool(inside)


def test_the_interval_of_the_tick_before_is_what_counts():
    state = tick(SkillState(), intervals=CALIBRATED, arx=9.0)
    wider = only(state).half_width_k
    assert wider > 0.5
    state = tick(state, intervals=CALIBRATED, arx=(0.5 + wider) / 2)
    assert only(state).covered == 0.5
    assert half_widths(state, CALIBRATED, "arx", "1", (5,))[5] == only(state).half_width_k


def test_a_new_version_begins_with_its_own_calibration():
    state = tick(SkillState(), intervals=CALIBRATED, arx=9.0)
    both = Intervals((*CALIBRATED.rows, replace(CALIBRATED.rows[0], version="2", half_width_k=0.3)))
    assert half_widths(state, both, "arx", "2", (5,)) == {5: 0.3}


# rivals


def test_a_rival_is_scored_against_the_active_one_on_the_same_ticks():
    state = tick(tick(SkillState(), arx=0.4), arx=0.2, arx_rival=0.1)
    active, rivals = ARX, {"arx": RampPredictor(), "pbm": RampPredictor()}
    (row,) = rival_rows(state, active, rivals)
    assert (row.model, row.horizon_s, row.count) == ("arx", 300.0, 1)
    assert (row.active_k, row.rival_k) == (pytest.approx(0.2), pytest.approx(0.1))


def test_a_rival_of_another_version_has_no_row():
    state = tick(SkillState(), arx=0.2, arx_rival=0.1)
    assert rival_rows(state, ARX, {"arx": RampPredictor(version="2")}) == ()
    assert rival_rows(state, {"arx": RampPredictor(version="2")}, ARX) == ()
    assert rival_rows(state, ARX, {}) == ()


# what survives a restart


def test_the_state_comes_back_from_json():
    state = tick(SkillState(), intervals=CALIBRATED, arx=0.1, pbm=0.2, arx_rival=0.3)
    assert decode_skill(json.loads(json.dumps(encode_skill(state), allow_nan=False))) == state


@pytest.mark.parametrize(
    "spoil",
    [
        lambda values: values["pairs"][0].pop(),
        lambda values: values["pairs"][0].__setitem__(5, -1),
        lambda values: values["widths"][0].__setitem__(3, 0.0),
    ],
)
def test_a_spoilt_state_is_refused(spoil):
    values = encode_skill(tick(SkillState(), intervals=CALIBRATED, arx=0.1))
    spoil(values)
    with pytest.raises(DataError):
        decode_skill(values)
