"""edge/twin/geometry.py: what is usual in a box as strong and as slow as this one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.runs import read_runs
from edge.twin.effects.library import EFFECTS, build
from edge.twin.geometry import POWERS, Geometry, Scale, scale_of
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest
from tests.support.simulated_runs import (
    BOX,
    as_diagnosis_runs,
    candidates_only,
    change_run,
    silent,
    simulate,
    twin_file,
)

pytestmark = pytest.mark.slow

EVERY = [(name, item) for name, effect in EFFECTS.items() for item in effect.parameters]


def test_the_papers_box_is_the_measure() -> None:
    assert scale_of(100.0, 60.0) == Scale(1.0, 1.0)
    assert TwinFile().scale == Scale(1.0, 1.0)
    for _, item in EVERY:
        assert Scale().usual(item) == item


def test_both_steps_and_answers_tell_how_slow_a_box_is() -> None:
    assert scale_of(50.0, 15.0).time == 0.25
    assert scale_of(50.0, 15.0, 150.0).time == 0.5
    assert scale_of(50.0, 15.0).heat == 0.5
    assert scale_of(50.0, 60.0, 1e9).time == 10.0  # no more than a file may have


@pytest.mark.parametrize(("name", "item"), EVERY)
def test_a_range_is_never_narrower_and_holds_its_start(name: str, item: object) -> None:
    parameter = EFFECTS[name].parameter(item.name)  # type: ignore[attr-defined]
    for scale in (Scale(0.02, 0.01), Scale(0.02, 30.0), Scale(5.0, 0.01), Scale(20.0, 30.0)):
        own = scale.usual(parameter)
        assert own.low <= parameter.low
        assert own.high >= parameter.high
        assert own.low <= own.start <= own.high
        assert (own.low > 0.0) == (parameter.low > 0.0)


@pytest.mark.parametrize("heat", [0.02, 1.0, 5.0])
@pytest.mark.parametrize("time", [0.05, 1.0, 10.0])
def test_a_box_that_is_smaller_and_quicker_by_the_factors_does_the_same(heat: float, time: float) -> None:
    effects = {
        name: {item.name: item.start for item in EFFECTS[name].parameters}
        for name in (
            "wall_loss",
            "extra_capacity",
            "heater_lag",
            "soil_mass",
            "sensor_lag",
            "natural_convection",
        )
    }
    scale = Scale(heat, time)
    scaled = {
        name: {key: value * scale.of(EFFECTS[name].parameter(key).unit) for key, value in own.items()}
        for name, own in effects.items()
    }
    usual = Geometry()
    other = replace(
        usual,
        volume_m3=usual.volume_m3 * heat * time,
        heater_max_w=usual.heater_max_w * heat,
        fan_max_m3_s=usual.fan_max_m3_s * heat,
    )
    duty, fan = np.array([[0.0, *[0.6] * 30, *[0.1] * 30]]), np.array([[0.0] * 45 + [1.0] * 16])
    temps = [
        twin.rollout(at_rest(twin, 20.0, 20.0), duty, fan, 20.0)
        for twin in (BoxTwin(usual, effects, 60.0), BoxTwin(other, scaled, 60.0 * time))
    ]
    assert temps[0].max() > 25.0
    # Bent heat is stepped in parts of so many seconds.
    assert temps[1] == pytest.approx(temps[0], abs=0.05)


def test_every_unit_of_heat_or_time_is_known() -> None:
    others = {"", "K", "1/K", "°C", "1/d"}
    assert {item.unit for _, item in EVERY} <= POWERS.keys() | others


def test_a_small_box_may_have_a_small_store_and_a_large_one_a_large_loss() -> None:
    small = Geometry(volume_m3=0.0005, heater_max_w=2.0)
    build(small, {"soil_mass": {"C_s": 5.0, "G_s": 0.002}}, 5.0)
    build(Geometry(volume_m3=1.0, heater_max_w=500.0), {"wall_loss": {"UA": 400.0}})
    build(Geometry(volume_m3=1e-5), {"extra_capacity": {"kC": 75_000.0}})  # a block of metal
    with pytest.raises(DataError, match=r"effects\.wall_loss\.UA: 4e\+06 is outside 0\.\.1e\+06 W/K"):
        build(Geometry(), {"wall_loss": {"UA": 4e6}})


def test_what_a_file_does_not_say_begins_where_it_is_usual_in_its_box() -> None:
    file = replace(
        twin_file(), geometry={**TwinFile().geometry, "heater_max_w": Value(10.0)}, sample_s=6.0, effects={}
    )
    assert file.usual(("effects", "wall_loss", "UA")).start == pytest.approx(0.4)
    assert file.usual(("effects", "heater_lag", "tau_h")).start == pytest.approx(18.0)
    assert replace(file, answer_s=1500.0).usual(("effects", "heater_lag", "tau_h")).start == pytest.approx(
        180.0
    )


def test_a_hot_box_is_read_where_the_twin_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "kiln.csv"
    rows = "\n".join(f"{60 * k},{20 + 4 * k},21,0.5,0" for k in range(60))
    path.write_text(f"time_s,temp_air_c,temp_ambient_c,heater_duty,fan_on\n{rows}\n", encoding="utf-8")
    with pytest.raises(DataError, match="is it Fahrenheit"):
        read_runs([path], [], twin_file())
    hot = replace(twin_file(), sensor={"quantisation_k": 0.0, "noise_sd_k": 0.1, "highest_c": 300.0})
    assert np.isfinite(read_runs([path], [], hot).train[0].run.columns["temp_air_c"]).all()


def test_sun_through_a_window_is_named_where_it_was_measured() -> None:
    rows = 80
    sun = np.clip(800.0 * np.sin(np.arange(rows) / 13.0), 0.0, None)
    runs = []
    for seed in (1, 2):
        plain = simulate(BOX, seed, rows)
        twin = BoxTwin(effects={**BOX, "solar_gain": {"A_sun": 0.04}})
        columns = plain.columns
        warmer = twin.rollout(
            np.array([0.0]),
            np.zeros((1, rows - 1)),
            columns["fan_on"][None, :-1],
            0.0,
            conditions={"solar": sun[:-1]},
        )[0]
        temps = columns["temp_air_c"] + np.concatenate([[0.0], warmer])
        runs.append(change_run(plain, temp_air_c=temps, solar_w_m2=sun))
    with candidates_only("solar_gain", "constant_heat", "led_gain"):
        found = diagnose(twin_file(), as_diagnosis_runs(runs), silent, "")
    assert [effect.name for effect in found.verdict.effects] == ["solar_gain"]
    assert found.verdict.effects[0].parameters["A_sun"].value == pytest.approx(0.04, rel=0.1)
