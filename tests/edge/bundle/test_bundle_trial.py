"""edge/bundle/trial.py: when a bundle has proved itself."""

import math
from dataclasses import replace

import pytest

from edge.bundle.trial import WORSE_ONCE, HorizonScore, Scores, TrialVerdict, judge

MODELS = ("arx", "pbm", "lstm", "ham")
HORIZONS_S = (60.0, 300.0, 900.0, 1800.0, 3600.0)


def scores(
    active_k: float, rival_k: float, count: int = 100, last: tuple[float, float] | None = None
) -> Scores:
    """Both bundles have the same errors in all models and horizons, but for the last row where given."""
    rows = [
        HorizonScore(model, horizon_s, count, active_k, rival_k)
        for model in MODELS
        for horizon_s in HORIZONS_S
    ]
    if last is not None:
        rows[-1] = HorizonScore("ham", 3600.0, count, *last)
    return Scores("1.0", "2.0", MODELS, rows)


@pytest.mark.parametrize(
    ("active_k", "rival_k", "shadow", "probation"),
    [
        (0.30, 0.20, TrialVerdict.PROMOTE, TrialVerdict.ROLL_BACK),
        (0.30, 0.30, TrialVerdict.PROMOTE, TrialVerdict.MARK_GOOD),  # as good is good enough
        (0.300, 0.312, TrialVerdict.WAIT, TrialVerdict.MARK_GOOD),  # 4 % worse: too little to say
        (0.312, 0.300, TrialVerdict.PROMOTE, TrialVerdict.MARK_GOOD),
        (0.300, 0.318, TrialVerdict.REJECT, TrialVerdict.MARK_GOOD),  # 6 %
        (0.318, 0.300, TrialVerdict.PROMOTE, TrialVerdict.ROLL_BACK),
        (0.001, 0.019, TrialVerdict.PROMOTE, TrialVerdict.MARK_GOOD),  # both below what the sensor can tell
        (0.0, 0.0, TrialVerdict.PROMOTE, TrialVerdict.MARK_GOOD),
        (0.0, 0.1, TrialVerdict.REJECT, TrialVerdict.MARK_GOOD),
        (0.3, math.nan, TrialVerdict.REJECT, TrialVerdict.MARK_GOOD),
        (0.3, math.inf, TrialVerdict.REJECT, TrialVerdict.MARK_GOOD),
        (math.nan, 0.3, TrialVerdict.PROMOTE, TrialVerdict.ROLL_BACK),
        (math.inf, 0.3, TrialVerdict.PROMOTE, TrialVerdict.ROLL_BACK),
        (math.nan, math.nan, TrialVerdict.REJECT, TrialVerdict.ROLL_BACK),
    ],
)
def test_errors_decide(
    active_k: float, rival_k: float, shadow: TrialVerdict, probation: TrialVerdict
) -> None:
    assert judge(scores(active_k, rival_k), on_probation=False, ticks=100).verdict is shadow
    assert judge(scores(active_k, rival_k), on_probation=True, ticks=100).verdict is probation


@pytest.mark.parametrize("on_probation", [False, True])
def test_nothing_is_decided_before_every_horizon_has_its_ticks(on_probation: bool) -> None:
    few = scores(0.3, 0.1, count=99)
    enough_but_once = replace(few, rows=[*scores(0.3, 0.1).rows, few.rows[-1]])
    for early in (few, enough_but_once, replace(few, rows=())):
        assert judge(early, on_probation, ticks=100).verdict is TrialVerdict.WAIT
    assert judge(scores(0.3, 0.3, count=100), on_probation, ticks=100).verdict is not TrialVerdict.WAIT
    assert "99 of 100 forecasts are scored for arx at 60 s" in judge(few, on_probation, ticks=100).why


@pytest.mark.parametrize("on_probation", [False, True])
def test_a_model_that_was_never_scored_leaves_the_trial_to_a_person(on_probation: bool) -> None:
    whole = scores(0.3, 0.1)
    told = judge(replace(whole, rows=[r for r in whole.rows if r.model != "ham"]), on_probation, ticks=100)
    assert told.verdict is TrialVerdict.WAIT
    assert told.why == "no forecast of ham has been scored in both bundles"


@pytest.mark.parametrize(("times", "verdict"), [(1.0, TrialVerdict.PROMOTE), (1.01, TrialVerdict.REJECT)])
def test_one_model_that_is_far_worse_at_one_horizon_is_enough(times: float, verdict: TrialVerdict) -> None:
    """The others are 20 % better."""
    told = judge(scores(0.30, 0.24, last=(0.30, 0.30 * WORSE_ONCE * times - 1e-9)), False, ticks=100)
    assert told.verdict is verdict
    assert "(ham at 3600 s)" in told.why


def test_the_reason_names_both_bundles_and_the_ratio() -> None:
    # 0.15 / 0.3 in every row
    assert judge(scores(0.3, 0.15), False, 100).why.startswith("errors of 2.0 are 0.500 times those of 1.0")
    assert judge(scores(0.3, 0.15), True, 100).why.startswith("errors of 1.0 are 2.000 times those of 2.0")
