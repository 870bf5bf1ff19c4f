from dataclasses import replace

import numpy as np
import pytest
from locate_runs import BASE, located, made

from edge.diagnosis.locate.regimes import DisagreementRegime, conditions, regimes
from edge.diagnosis.locate.rows import rows_of
from edge.diagnosis.locate.stretches import _richest, stretches
from edge.diagnosis.location import findings, percent, regime_sentence, with_error


def test_a_right_twin_has_no_regime_and_says_so():
    runs = located(made(BASE, count=10))
    assert regimes(runs) == []
    assert stretches(runs) == []
    assert findings([], []) == [
        "The squared error is spread evenly: no regime and no time has more than its share"
    ]


def test_a_hidden_loss_lies_where_the_box_is_warm_and_the_model_gains_too_much():
    runs = located(made({**BASE, "wall_loss": {"UA": 6.0}}, count=10))
    first = regimes(runs)[0]
    assert "T - T_amb >" in first.where
    assert first.share_low < first.share_of_squared_error < first.share_high
    assert first.share_of_squared_error > 2.0 * first.share_of_rows
    excess = np.concatenate([run.excess_k[mask] for run, mask in zip(runs, first.masks, strict=True)])
    assert sum(mask.sum() for mask in first.masks) == first.rows == len(excess)
    # 2 W/K that the twin does not know, over the rows of the regime.
    assert first.heat_w == pytest.approx(-2.0 * excess.mean(), abs=3.0 * first.heat_w_se + 0.3)
    assert regime_sentence(first).endswith("W too much")


def test_a_weak_fan_lies_where_the_fan_is_on_and_the_model_gains_too_little():
    runs = located(made({**BASE, "fan_effectiveness": {"eps_f": 0.7}}, count=10))
    first = regimes(runs)[0]
    assert "the fan" in first.where
    assert first.heat_w > 4.0 * first.heat_w_se > 0.0
    assert regime_sentence(first).endswith("W too little")


def test_a_constant_heat_has_its_watts_in_each_regime():
    found = regimes(located(made({**BASE, "constant_heat": {"P0": 5.0}}, count=10)))
    assert found[0].where.startswith("the fan is off")
    for regime in found:
        assert regime.heat_w == pytest.approx(5.0, abs=0.2)


def test_regimes_do_not_say_the_same_twice():
    runs = located(made({**BASE, "wall_loss": {"UA": 6.0}}, count=10))
    found = regimes(runs)
    squared = np.concatenate([np.nan_to_num(run.free_run_k) ** 2 for run in runs])
    for i, one in enumerate(found):
        for other in found[:i]:
            masks = np.concatenate(one.masks), np.concatenate(other.masks)
            smaller = min(squared[mask].sum() for mask in masks)
            assert squared[masks[0] & masks[1]].sum() < 0.8 * smaller


def test_few_rows_are_not_believed():
    runs = [run for run in located(made(BASE, count=10))]
    broken = runs[3].free_run_k.copy()
    broken[40:50] += 30.0  # all of the error in ten rows of one run
    runs[3] = replace(runs[3], free_run_k=broken)
    assert regimes(runs) == []
    (stretch,) = stretches(runs)
    assert (stretch.run, stretch.from_row, stretch.to_row) == ("run_3", 40, 50)
    assert (stretch.from_s, stretch.to_s) == (2400.0, 3000.0)
    assert stretch.share > 0.9
    assert stretch.rmse_k == pytest.approx(30.0, rel=0.02)


def test_no_run_and_no_counted_row_have_no_regime():
    assert regimes([]) == []
    run = located(made(BASE, count=1))[0]
    unknown = replace(run, free_run_k=np.full_like(run.free_run_k, np.nan))
    assert regimes([unknown]) == []
    assert stretches([unknown]) == []


def test_just_switched_counts_rows_from_the_switch():
    run = located(made(BASE, count=1, rows=12))[0]
    duty = np.array([0, 0, 0.4, 0.4, 0.4, 0.2, 0, 0, 0.2, 0, 0, 0])
    rows = rows_of([replace(run, duty=duty)])
    masks = {item.where: np.flatnonzero(item.mask).tolist() for item in conditions(rows)}
    assert masks["the heater has just gone on (first row)"] == [2, 8]
    assert masks["the heater has just gone on (first 2 rows)"] == [2, 3, 8]
    assert masks["the heater has just gone off (first 5 rows)"] == [6, 7, 9, 10, 11]  # not the start
    assert masks["the duty is 0 to 0.25"] == [5, 8]
    assert "the duty is 0.5 to 0.75" not in masks  # never


def test_light_hour_day_and_humidity_are_asked_where_they_are_known():
    rows = 180
    utc = 1.0e9 + 60.0 * np.arange(rows) + np.array([[0.0], [86400.0], [180000.0]])
    light = np.repeat([[0.0, 1.0]], 3, axis=0).repeat(rows // 2, axis=1)
    more = {"utc": utc, "light": light, "rel_humidity": 50.0 + 5.0 * np.sin(utc / 900.0)}
    runs = located(replace(made(BASE, count=3, rows=rows), conditions=more))
    wheres = {item.where for item in conditions(rows_of(runs))}
    # 1e9 s is 2001-09-09 01:46:40 UTC
    assert {"the light is on", "on day 1", "on day 3", "between 00 and 03 h UTC"} <= wheres
    assert any("humidity >" in where for where in wheres)
    assert not any("UTC" in item.where for item in conditions(rows_of(located(made(BASE, count=3)))))


REGIME = DisagreementRegime(
    "the fan is off and T - T_amb > 6 K", 0.712, 0.6, 0.8, 0.2, 300, 1.2, -38.2, 3.1, ()
)


@pytest.mark.parametrize(
    ("heat", "error", "end"),
    [
        (-38.2, 3.1, "there the model gains 38 ± 3 W too much"),
        (38.2, 3.1, "there the model gains 38 ± 3 W too little"),
        (-38.2, 19.1, "there the residual heat averages -38 ± 19 W: no clear direction"),
        (-5.25, 0.13, "there the model gains 5.25 ± 0.13 W too much"),
    ],
)
def test_a_sentence_has_the_right_sign_and_digits(heat, error, end):
    begin = "71 % of the squared error lies where the fan is off and T - T_amb > 6 K (20 % of the rows); "
    heat = -38.0 if error == 19.1 else heat
    assert regime_sentence(replace(REGIME, heat_w=heat, heat_w_se=error)) == begin + end


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (38.21, 3.14, "38 ± 3"),
        (38.21, 0.96, "38 ± 1"),
        (1234.0, 95.0, "1200 ± 100"),
        (1234.0, 57.0, "1230 ± 60"),
        (0.123, 0.0149, "0.123 ± 0.015"),
        (5.0, 0.0, "5"),
        (2.0, 0.194, "2.00 ± 0.19"),
    ],
)
def test_errors_have_one_digit_or_two_that_begin_with_1(value, error, text):
    assert with_error(value, error) == text


SHARES = {0.0: "0 %", 0.003: "less than 1 %", 0.714: "71 %", 0.998: "more than 99 %", 1.0: "100 %"}


@pytest.mark.parametrize(("share", "text"), SHARES.items())
def test_percent(share, text):
    assert percent(share) == text


def test_the_richest_ranges_are_those_of_the_largest_sums():
    values = np.array([-5.0, 2.0, -1.0, 3.0, -9.0, 1.0, -2.0, 4.0])
    assert _richest(values)[0] == (1, 4)  # 2 - 1 + 3
    assert sorted(_richest(values)) == [(1, 4), (5, 6), (7, 8)]
    assert _richest(-np.ones(3)) == []
