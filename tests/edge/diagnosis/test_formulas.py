"""edge/diagnosis/formulas.py: small formulas that stand in for what has no name."""

import re
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.formulas import HEAT_SD, PREFIX, READING_SD_K, FormulaShape, formulas, shapes
from edge.diagnosis.trial import SizedTerm
from edge.twin.run_batch import RunBatch

STEP_S = 60.0
HOUR_UTC = 1_782_896_400.0  # 2026-07-01 09:00 UTC
HEATER_W = 100.0
SHAPES = shapes()
WORDS = {"heater_duty", "fan_on", "temp_air", "temp_ambient", "light", "rel_humidity", "time"}


def recording(rows: int = 120, runs: int = 2) -> RunBatch:
    """Everything moves; the second run begins a day later."""
    draw = np.random.default_rng(1)
    shape = (runs, rows)
    utc = HOUR_UTC + STEP_S * np.arange(rows) + 86400.0 * np.arange(runs)[:, None]
    return RunBatch(
        25.0 + 10.0 * draw.random((runs, rows + 1)),
        draw.choice([0.0, 0.5, 1.0], shape),
        draw.choice([0.0, 1.0], shape),
        20.0 + draw.random(shape),
        {"light": draw.random(shape), "rel_humidity": 40.0 + 40.0 * draw.random(shape), "utc": utc},
    )


LEVELS = (29.0, 31.0, 30.0, 20.0)  # warm, hot, usual and the room's, of `recording`


def found(runs: RunBatch) -> dict[str, tuple[FormulaShape, SizedTerm]]:
    return formulas(runs, runs.temp, STEP_S)


def term(text: str, runs: RunBatch) -> SizedTerm:
    return found(runs)[PREFIX + text][1]


def test_texts_are_names_and_say_what_they_depend_on() -> None:
    assert len({shape.text for shape in SHAPES}) == len(SHAPES)
    for shape in SHAPES:
        assert shape.depends_on, shape.text
        assert set(shape.depends_on) <= WORDS, shape.text
        assert len(set(shape.depends_on)) == len(shape.depends_on), shape.text


def test_a_unit_is_a_watt_or_a_kelvin_for_each_unit_of_what_it_multiplies() -> None:
    for shape in SHAPES:
        assert re.fullmatch(r"[WK](/(K[23]?|h|d|%))*", shape.unit), shape.text
        assert shape.unit.startswith("K") == shape.of_reading, shape.text
        assert shape.of_reading == shape.text.startswith("reading: "), shape.text


@pytest.mark.parametrize("text", ["1", "u", "u^2", "L", "T - T_amb", "fan (T - T_amb)", "reading: 1"])
def test_what_a_named_effect_says_is_left_to_it(text: str) -> None:
    assert text not in {shape.text for shape in SHAPES}


def test_what_the_runs_have_columns_for_is_offered() -> None:
    runs = recording()
    everything = found(runs)
    assert set(everything) <= {PREFIX + shape.text for shape in shapes(*LEVELS)}
    assert {"~u fan", "~L fan", "~RH - 50", "~day", "~reading: t"} <= set(everything)
    bare = found(replace(runs, conditions={}))
    assert set(everything) - set(bare) == {
        name for name, (shape, _) in everything.items() if set(shape.needs) & {"L", "RH", "day", "hour"}
    }


@pytest.mark.parametrize(
    ("still", "gone"),
    [("fan", ["~fan", "~u fan", "~fan (T - T_amb)^2"]), ("duty", ["~u fan", "~u t", "~reading: u"])],
)
def test_what_never_moves_is_not_offered(still: str, gone: list[str]) -> None:
    runs = recording()
    assert set(gone) <= set(found(runs))
    assert not set(gone) & set(found(replace(runs, **{still: np.zeros_like(runs.fan)})))


def test_a_fan_that_always_runs_is_no_formula_of_its_own() -> None:
    runs = replace(recording(), fan=np.ones((2, 120)))
    assert "~fan" not in found(runs)  # a constant heat, which has a name
    assert "~fan (T - T_amb)^2" in found(runs)


def test_values_are_those_of_the_middle_of_each_row() -> None:
    runs = recording()
    temp, duty, fan, room = runs.temp[1], runs.duty[1], runs.fan[1], runs.ambient[1]
    k = 40
    middle = 0.5 * (temp[k] + temp[k + 1])
    excess, hours = middle - room[k], k * STEP_S / 3600.0
    # The second run began a day after the first, at 9 h.
    day, hour = 1.0 + k * STEP_S / 86400.0, 9.0 + hours
    expected = {
        "u (T - T_amb)": duty[k] * excess,
        "fan (T - T_amb)^2": fan[k] * excess**2,
        "max(T - 29, 0)": max(middle - 29.0, 0.0),
        "T_amb - 20": room[k] - 20.0,
        "u t": duty[k] * hours,
        "fan hours of fan (T - T_amb)": fan[k] * fan[: k + 1].sum() * STEP_S / 3600.0 * excess,
        "u day": duty[k] * day,
        "sin(day)": np.sin(2.0 * np.pi * hour / 24.0),
        "half a sine of the day, 8..16 h": np.sin(np.pi * (hour - 8.0) / 8.0),
        "L (T - T_amb)": runs.conditions["light"][1, k] * excess,
        "reading: RH - 50": runs.conditions["rel_humidity"][1, k] - 50.0,
    }
    for text, value in expected.items():
        assert term(text, runs).shape[k, 1] == pytest.approx(value), text
    assert "~half a sine of the day, 4..8 h" not in found(runs)  # over before the runs began


def test_before_it_is_seen_a_formula_is_of_one_size_whatever_its_unit() -> None:
    runs = recording()
    for shape, one in found(runs).values():
        rms = np.sqrt(np.mean(one.shape**2))
        assert one.sd * rms == pytest.approx(READING_SD_K if shape.of_reading else HEAT_SD * HEATER_W)
        assert one.of_reading == shape.of_reading
        assert one.shape.shape == (120, 2)


def test_rows_without_a_temperature_and_padding_have_no_say() -> None:
    runs = recording()
    temp = runs.temp.copy()
    temp[0, 50:60] = np.nan
    temp[1, 90:] = np.nan
    for _, one in found(replace(runs, temp=temp)).values():
        assert np.isfinite(one.shape).all()
        assert (one.shape[49:59, 0] == 0.0).all()
        assert (one.shape[89:, 1] == 0.0).all()


def test_what_a_temperature_was_expected_to_be_is_taken_not_its_reading() -> None:
    runs = recording()
    smooth = np.full_like(runs.temp, 30.0)
    _, one = formulas(runs, smooth, STEP_S)["~u max(T - 29, 0)"]
    assert one.shape == pytest.approx(runs.duty.T)
