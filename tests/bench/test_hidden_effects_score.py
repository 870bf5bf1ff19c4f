"""The benchmark's scorer, on truths and diagnoses made by hand: every expected figure is counted here."""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import pytest

from bench.hidden_effects.cases import HiddenEffect, RunTruth, Truth
from bench.hidden_effects.score import document, figures, write_document
from bench.hidden_effects.score_aliases import AliasClass
from bench.hidden_effects.score_case import (
    FreeRunErrors,
    ScoredCase,
    answer,
    cases_of,
    errors,
    read_answer,
    read_truth,
    score,
)
from bench.hidden_effects.table import markdown, text
from bench.hidden_effects.wilson import Share
from edge.core.errors import DataError

MEASURED = [20.0, 20.0, 21.0, 23.0, 22.0]  # two rows given, three to forecast
FLOOR = [20.0, 20.0, 21.1, 22.9, 22.1]  # off by 0.1 in each: RMSE 0.1
BEFORE = [20.0, 20.0, 22.0, 24.0, 23.0]  # off by 1
AFTER = [20.0, 20.0, 21.2, 22.8, 22.2]  # off by 0.2


def truth(kind: str = "single", *names: str, depends_on: tuple[str, ...] = (), **parameters: float) -> Truth:
    """A truth of a kind with hidden effects, all with these parameters."""
    hidden = tuple(HiddenEffect(name, parameters, 1.0) for name in names)
    outside = HiddenEffect("sun", {}, 1.0) if kind == "outside" else None
    tests = {"test_01.csv": RunTruth(list(MEASURED), FLOOR, FLOOR)}
    return Truth(
        "case_1", "equations", "dev", kind, 1, hidden, outside, depends_on, ("wall_loss",), {}, {}, tests
    )


def effect(name: str, *alternatives: str, **intervals: tuple[float, float]) -> dict[str, Any]:
    parameters = {
        key: {"value": sum(ends) / 2.0, "low": ends[0], "high": ends[1], "unit": ""}
        for key, ends in intervals.items()
    }
    return {"name": name, "alternatives": list(alternatives), "log_odds": 9.0, "parameters": parameters}


def diagnosis(
    *effects: dict[str, Any], verdict: str = "", depends_on: tuple[str, ...] = ()
) -> dict[str, Any]:
    verdict = verdict or ("named" if effects else "nothing_missing")
    predictions = {"test_01.csv": {"before": BEFORE, "after": AFTER}}
    return {"verdict": verdict, "effects": list(effects), "depends_on": list(depends_on),
            "predictions": predictions}  # fmt: skip


def classes(*names: str, **behind: float) -> tuple[AliasClass, ...]:
    return tuple(AliasClass(name, behind, 100.0) for name in names)


def scored(
    kind: str, names: tuple[str, ...], given: dict[str, Any] | None, seconds: float = 1.0
) -> ScoredCase:
    """With classes of one."""
    return score(truth(kind, *names), classes(*names), None if given is None else answer(given), seconds)


def test_wilsons_interval_is_that_of_the_textbook():
    # Newcombe 1998, Statistics in Medicine 17, table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for hits, cases, low, high in [
        (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718),
    ]:  # fmt: skip
        assert Share(hits, cases).interval == pytest.approx((low, high), abs=5e-5)


def test_a_share_of_no_case_says_nothing():
    assert math.isnan(Share(0, 0).value)
    assert Share(0, 0).interval == (0.0, 1.0)
    assert Share(0, 0).document()["value"] is None
    assert Share(5, 5).interval[1] == 1.0
    with pytest.raises(ValueError, match="6 hits of 5"):
        Share(6, 5)


def test_the_first_name_and_the_set_are_two_questions():
    right = scored("single", ("heater_lag",), diagnosis(effect("heater_lag")))
    second = scored("single", ("heater_lag",), diagnosis(effect("led_gain"), effect("heater_lag")))
    more = scored("single", ("heater_lag",), diagnosis(effect("heater_lag"), effect("led_gain")))
    wrong = scored("single", ("heater_lag",), diagnosis(effect("led_gain")))
    assert [(one.first_right, one.exact) for one in (right, second, more, wrong)] == [
        (True, True), (False, False), (True, False), (False, False),
    ]  # fmt: skip
    assert [one.true_names / one.names for one in (right, second, more, wrong)] == [1.0, 0.5, 0.5, 0.0]


def test_a_member_of_the_class_is_as_good_as_the_effect():
    own = classes("fan_effectiveness", short_circuit=0.4, led_gain=3.1, soil_mass=-6.1)
    named = {
        name: score(truth("single", "fan_effectiveness"), own, answer(diagnosis(effect(name)))).exact
        for name in ("short_circuit", "led_gain", "soil_mass")
    }
    assert named == {"short_circuit": True, "led_gain": False, "soil_mass": False}


def test_one_name_finds_one_effect_and_an_exact_name_goes_first():
    own = (AliasClass("fan_effectiveness", {"short_circuit": 0.0}), AliasClass("short_circuit", {}))
    both = truth("pair", "fan_effectiveness", "short_circuit")
    once = score(both, own, answer(diagnosis(effect("short_circuit"))))
    assert once.found == (False, True)
    twice = score(both, own, answer(diagnosis(effect("short_circuit"), effect("short_circuit"))))
    assert twice.found == (True, True)
    assert twice.exact


def test_more_than_five_alternatives_are_no_answer():
    others = ["led_gain", "soil_mass", "wall_mass", "heater_sag", "infiltration", "ua_drift"]
    five = scored("single", ("heater_lag",), diagnosis(effect("heater_lag", *others[:5])))
    six = scored("single", ("heater_lag",), diagnosis(effect("heater_lag", *others)))
    itself = scored("single", ("heater_lag",), diagnosis(effect("heater_lag", *others[:5], "heater_lag")))
    assert (five.first_right, six.first_right, itself.first_right) == (True, False, True)
    assert (six.found, six.exact, six.names, six.true_names) == ((False,), False, 1, 0)


def test_a_class_is_told_honestly_where_what_is_clear_is_told_right():
    # Clearly in: within 2 nats. Clearly out: beyond 6. Anything between may be told or not.
    own = classes(
        "heater_lag", heater_deadtime=1.9, sensor_lag=2.1, soil_mass=5.9, led_gain=6.1, ua_drift=-9.0
    )

    def told(*alternatives: str) -> tuple[bool, bool]:
        found = score(
            truth("single", "heater_lag"), own, answer(diagnosis(effect("heater_lag", *alternatives)))
        )
        return found.told[0], found.told_exactly[0]

    assert told("heater_deadtime") == (True, False)
    assert told("heater_deadtime", "sensor_lag") == (True, True)  # the class itself: within 3 nats
    assert told("heater_deadtime", "soil_mass", "ua_drift") == (True, False)
    assert told() == (False, False)
    assert told("heater_deadtime", "led_gain") == (False, False)
    assert told("heater_deadtime", "wall_mass") == (False, False)
    other_way = score(truth("single", "heater_lag"), own,
                      answer(diagnosis(effect("heater_deadtime", "heater_lag"))))  # fmt: skip
    assert other_way.told == (True,)
    assert other_way.has_rivals == (True,)


def test_intervals_count_where_the_name_is_exactly_right():
    one = truth("single", "heater_lag", tau_h=100.0)
    own = classes("heater_lag", heater_deadtime=0.0)

    def covered(document: dict[str, Any]) -> list[bool]:
        return list(score(one, own, answer(document)).covered.values())

    assert covered(diagnosis(effect("heater_lag", tau_h=(100.0, 120.0)))) == [True]  # the end belongs to it
    assert covered(diagnosis(effect("heater_lag", tau_h=(100.1, 120.0)))) == [False]
    assert covered(diagnosis(effect("heater_deadtime", d_h=(90.0, 110.0)))) == []
    assert covered(diagnosis(effect("heater_lag"))) == []
    endless = effect("heater_lag", tau_h=(90.0, 110.0))
    endless["parameters"]["tau_h"]["low"] = None
    assert covered(diagnosis(endless)) == [False]


def test_the_gap_is_that_of_the_rows_whose_temperature_was_not_given():
    found = errors(truth().tests, answer(diagnosis()))
    assert found is not None
    # RMSE 1, 0.2 and 0.1 of the three rows: (1 - 0.2) / (1 - 0.1) and 0.2 / 0.1
    assert (found.before_k, found.after_k, found.floor_k) == pytest.approx((1.0, 0.2, 0.1))
    assert found.shrink == pytest.approx(0.8 / 0.9)
    assert found.ratio == pytest.approx(2.0)


def test_a_row_that_was_not_measured_does_not_count():
    own = RunTruth([20.0, 20.0, 21.0, None, 22.0], FLOOR, FLOOR)
    wild = diagnosis()
    wild["predictions"]["test_01.csv"]["after"] = [0.0, 0.0, 21.2, None, 22.2]
    found = errors({"test_01.csv": own}, answer(wild))
    assert found is not None
    assert found.after_k == pytest.approx(0.2)
    assert errors({"test_01.csv": RunTruth([20.0, 20.0, None], FLOOR[:3], FLOOR[:3])}, answer(wild)) is None


@pytest.mark.parametrize(
    "after", [[20.0, 20.0, None, 23.0, 22.0], [20.0, 20.0, math.nan, 23.0, 22.0], [*AFTER, 22.0], []]
)
def test_a_prediction_with_a_hole_or_of_another_length_is_infinitely_wrong(after: list[float | None]):
    given = diagnosis()
    given["predictions"]["test_01.csv"]["after"] = after
    found = errors(truth().tests, answer(given))
    assert found is not None
    assert found.after_k == math.inf
    assert found.shrink == -math.inf
    assert errors(truth().tests, None) == FreeRunErrors(math.inf, math.inf, found.floor_k)


def test_a_gap_that_was_none_cannot_shrink():
    assert FreeRunErrors(1.05, 0.5, 1.0).shrink is None
    assert FreeRunErrors(1.06, 1.0, 1.0).shrink == pytest.approx(1.0)


def test_of_what_an_unknown_effect_depends_on_the_first_two_count():
    outside = truth("outside", depends_on=("light", "time"))

    def right(*words: str, verdict: str = "unknown") -> bool | None:
        return score(outside, (), answer(diagnosis(verdict=verdict, depends_on=words))).dependence

    assert right("fan_on", "light") is True
    assert right("fan_on", "temp_air", "light") is False
    assert right("light", verdict="nothing_missing") is False
    assert score(outside, (), None).dependence is False
    assert score(truth("null"), (), answer(diagnosis(verdict="unknown"))).dependence is None


def test_a_case_without_an_answer_is_wrong_in_everything():
    case = scored("single", ("heater_lag",), None, seconds=600.0)
    found = figures([case, scored("null", (), None)])
    assert case.failed
    assert [found[key].value for key in ("naming", "exact_single", "told", "shrink")] == [0.0] * 4
    assert found["false_alarms"].value == 1.0
    assert found["failed"].value == 1.0
    assert found["ratio_median"] == math.inf
    assert found["seconds_worst"] == 600.0


def test_figures_are_counted_over_the_kinds_that_they_are_about():
    lag = diagnosis(effect("heater_lag"))
    cases = [
        scored("null", (), diagnosis()),
        scored("null", (), diagnosis(verdict="unknown")),  # a false alarm, and unknown said wrongly
        scored("single", ("heater_lag",), lag, seconds=2.0),
        scored("single", ("heater_lag",), diagnosis(verdict="unknown"), seconds=9.0),
        scored("pair", ("heater_lag", "led_gain"), lag),
        scored("pair", ("heater_lag", "led_gain"), diagnosis(effect("led_gain"), effect("heater_lag"))),
        scored("weak", ("heater_lag",), lag),
        scored("bare", ("heater_lag", "led_gain", "soil_mass"),
               diagnosis(effect("soil_mass"), effect("heater_lag"), effect("ua_drift"))),
        score(truth("outside", depends_on=("light",)), (),
              answer(diagnosis(verdict="unknown", depends_on=("light",))), 1.0),
        score(truth("outside", depends_on=("light",)), (), answer(lag), 1.0),
    ]  # fmt: skip
    found = figures(cases)
    expected = {
        "naming": (1, 2), "exact_single": (1, 2), "exact_pair": (1, 2), "weak": (1, 1), "hard": (0, 0),
        "bare_found": (2, 3), "bare_true": (2, 3), "false_alarms": (1, 2), "unknown": (1, 2),
        "dependence": (1, 2), "unknown_wrongly": (2, 8), "failed": (0, 10),
        "told": (7, 10),  # 1 + 0 of singles, 1 of 2 and 2 of pairs, 1 weak, 2 of 3 bare
        "shrink": (0, 6),  # each 0.89, below 0.9
        "found_shown": (5, 7), "bare_found_shown": (2, 3), "shown": (10, 10), "told_rivals": (0, 0),
    }  # fmt: skip
    assert {key: (found[key].hits, found[key].cases) for key in expected} == expected
    assert (found["seconds_median"], found["seconds_worst"]) == (1.0, 9.0)
    assert found["ratio_p90"] == pytest.approx(2.0)
    assert found["shrink_mean"] == pytest.approx(0.8 / 0.9)


def test_an_effect_that_the_runs_do_not_show_is_told_apart():
    hidden = truth("weak", "heater_lag")
    silent = score(hidden, (AliasClass("heater_lag", {}, 2.9),), answer(diagnosis()))
    shown = score(hidden, (AliasClass("heater_lag", {}, 3.0),), answer(diagnosis()))
    assert (silent.shows, shown.shows) == ((False,), (True,))
    found = figures([silent, shown])
    assert (found["shown"].hits, found["found_shown"].cases, found["told"].cases) == (1, 1, 1)


def test_no_case_has_tables_all_the_same():
    found = figures([])
    assert found["naming"].cases == 0
    assert math.isnan(found["seconds_median"])
    content = document({"diagnose": []}, {"suite": "equations", "split": "dev", "cases": 0})
    assert "one effect: first name right" in text(content)
    assert "nan" not in text(content)


def test_tables_put_each_figure_beside_its_target(tmp_path: Path):
    cases = [scored("single", ("heater_lag",), diagnosis(effect("heater_lag")), 4.0) for _ in range(2)]
    content = document(
        {"diagnose": cases, "stepwise": [scored("single", ("heater_lag",), None)]},
        {"suite": "equations", "split": "scored", "cases": 2},
    )
    write_document(tmp_path / "score.json", content)  # infinity and NaN would be refused
    read = json.loads((tmp_path / "score.json").read_text())
    lines = markdown(read).splitlines()
    assert "| figure | target | met | diagnose (2) | stepwise (1) |" in lines
    # Wilson of 2 of 2: 2 / (2 + 3.8415) = 0.34; of 0 of 1: 3.8415 / 4.8415 = 0.79
    assert (
        "| one effect: first name right | 0.97 | yes | 1.00 [0.34, 1.00] of 2 | 0.00 [0.00, 0.79] of 1 |"
        in lines
    )
    assert "| gap shrink 0.9 or more | 0.95 | no | 0.00 [0.00, 0.66] of 2 | 0.00 [0.00, 0.79] of 1 |" in lines
    assert "| heater_lag | 1.00 [0.34, 1.00] of 2 |" in lines


@pytest.mark.parametrize(
    "broken",
    [
        {"verdict": "perhaps"},
        {"effects": []},  # named, but nothing is
        {"effects": [{"name": "heater_lag"}]},
        {"effects": None},
        {"predictions": {"test_01.csv": {"before": ["warm"], "after": []}}},
        {"depends_on": None},
    ],
)
def test_what_is_no_diagnosis_is_refused_by_name(tmp_path: Path, broken: dict[str, Any]):
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(diagnosis(effect("heater_lag")) | broken))
    with pytest.raises(DataError, match=r"diagnosis\.json: no diagnosis"):
        read_answer(path)


def test_a_missing_or_cut_diagnosis_is_refused_by_name(tmp_path: Path):
    path = tmp_path / "diagnosis.json"
    with pytest.raises(DataError, match=r"diagnosis\.json"):
        read_answer(path)
    path.write_text('{"verdict": "named", "eff')
    with pytest.raises(DataError, match=r"diagnosis\.json"):
        read_answer(path)


def test_names_beside_another_verdict_have_no_say():
    assert answer(diagnosis(effect("heater_lag"), verdict="unknown")).effects == ()


def test_truths_are_read_back_and_others_refused(tmp_path: Path):
    whole = truth("pair", "heater_lag", "led_gain", tau_h=3.0)
    place = tmp_path / "equations" / "dev" / "truth"
    place.mkdir(parents=True)
    path = place / "case_1.json"
    path.write_text(json.dumps(whole.document()))
    assert read_truth(path) == whole
    asked = argparse.Namespace(
        root=tmp_path, suite="equations", split="dev", kinds="single,pair", per_kind=None
    )
    assert [item.folder.name for item in cases_of(asked)] == ["case_1"]
    asked.kinds = "null"
    with pytest.raises(DataError, match="no case of null"):
        cases_of(asked)
    path.write_text(json.dumps(whole.document() | {"generator_version": 0}))
    with pytest.raises(DataError, match="version 0"):
        read_truth(path)
