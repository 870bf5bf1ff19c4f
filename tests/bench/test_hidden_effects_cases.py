"""Cases with hidden effects: simulated independently, the same for the same seed, the truth kept apart."""

import json
from pathlib import Path

import numpy as np
import pytest
from twin_equations import shown

from bench.hidden_effects import chamber_cases, make
from bench.hidden_effects.case_files import Sensing, read_temps
from bench.hidden_effects.cases import FIRST_SEEDS, GIVEN_ROWS, KINDS, case_id, seed_of
from bench.hidden_effects.chamber_box import (
    BASE,
    DIRECT,
    LEAD_ROWS,
    OUTSIDE,
    SETTINGS,
    RunPlan,
    believed_c,
    chamber_of,
    draw_base,
    draw_known,
    drive,
    quiet_c,
    read_off,
)
from bench.hidden_effects.equations import NEUTRAL, STATES, simulate
from bench.hidden_effects.equations_box import OUTSIDE as NAMELESS
from bench.hidden_effects.equations_box import STRENGTHS, draw_effect
from bench.hidden_effects.equations_cases import (
    adding,
    draw_scene,
    flat,
    hide,
    make_case,
    rms_k,
    strength_for,
    without,
)
from bench.hidden_effects.inputs import BEFORE_ROWS, Bend, ColumnInputs
from edge.formats.run_file import read_run
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS
from edge.twin.twin_file import read_twin_file

ROWS = 16
BOXES = {
    "walls, soil, element, zones, sensors": {
        "wall_mass": {"C_w": 8000.0, "G_in": 9.0, "G_out": 8.0},
        "extra_capacity": {"kC": 3.0},
        "soil_mass": {"C_s": 1e4, "G_s": 3.0},
        "radiative_split": {"f_rad": 0.3},
        "heater_lag": {"tau_h": 200.0},
        "imperfect_mixing": {"F_mix": 0.01},
        "sensor_lag": {"tau_s": 50.0},
        "sensor_bias": {"bias": 0.7},
        "ambient_offset": {"b_amb": 0.5},
    },
    "losses, light, moisture, ageing, a door": {
        "wall_loss": {"UA": 3.0},
        "extra_capacity": {"kC": 3.0},
        "longwave_radiation": {"epsA": 0.4},
        "infiltration": {"F_inf": 0.002},
        "evapotranspiration": {"k_e": 8.0},
        "led_gain": {"P_led": 20.0},
        "constant_heat": {"P0": 4.0},
        "door_opening": {"G_door": 20.0},
        "ua_drift": {"ua_drift": 0.05},
        "heater_sag": {"sag": 0.1},
        "heater_saturation": {"u_sat": 0.7},
        "heater_efficiency": {"eta": 0.9},
        "fan_effectiveness": {"eps_f": 0.7},
        "short_circuit": {"s_sc": 0.2},
    },
    "late commands": {
        "wall_loss": {"UA": 4.0},
        "extra_capacity": {"kC": 4.0},
        "heater_deadtime": {"d_h": 45.0},
        "fan_deadtime": {"d_f": 75.0},
        "fan_spinup": {"tau_f": 40.0},
    },
}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case as the command makes it: a hidden heater_efficiency on short logs."""
    folder = tmp_path_factory.mktemp("hidden")
    words = ["--suite", "equations", "--per-kind", "1", "--out", str(folder)]
    assert make.main([*words, "--kinds", "hard", "--seed-from", "7"]) == 0
    return folder


def inputs(columns: int = 1) -> ColumnInputs:
    rng = np.random.default_rng(5)
    shape = (ROWS, columns)
    nothing = np.zeros(shape)
    return ColumnInputs(
        duty=np.repeat(rng.integers(0, 21, (ROWS // 4, columns)) / 20.0, 4, axis=0),
        fan=np.repeat(rng.integers(0, 2, (ROWS // 4, columns)), 4, axis=0).astype(float),
        ambient=np.full((ROWS + 1, columns), 21.0),
        light=rng.random(shape),
        rel_humidity=40.0 + 20.0 * rng.random(shape),
        day=nothing + 2.0,
        hour=nothing + 12.0,
        door=np.where(rng.random(shape) < 0.2, 0.5, 0.0),
        power=nothing + 1.0,
        heat_w=nothing,
        chance=rng.normal(size=shape),
    )


@pytest.mark.parametrize("name", BOXES)
def test_the_simulator_makes_what_scipy_makes_of_the_equations(name: str) -> None:
    given, effects = inputs(), BOXES[name]
    p = flat(effects)
    readings, _ = simulate({key: np.array([value]) for key, value in p.items()}, given)
    room = 21.0 - p.get("b_amb", 0.0)
    start = {state: room for state in STATES} | {"heater": 0.0, "fan": 0.0}
    columns = {key: getattr(given, key)[:, 0] for key in ("ambient", "light", "rel_humidity", "day", "door")}
    expected = shown(effects, start, given.duty[:, 0], given.fan[:, 0], columns)
    # A late command's mean over a part of 2.5 s is what is not exact.
    assert np.abs(readings[1:, 0] - expected).max() < (0.03 if name == "late commands" else 0.001)


def test_columns_of_a_batch_do_not_touch_each_other() -> None:
    given, p = inputs(2), {"UA": np.array([3.0, 5.0]), "tau_h": np.array([0.0, 120.0])}
    together, _ = simulate(p, given)
    for b in range(2):
        alone, _ = simulate({key: values[[b]] for key, values in p.items()}, given.columns([b]))
        assert np.abs(together[:, b] - alone[:, 0]).max() < 0.001


def test_heat_noise_mains_and_a_bent_loss_disturb_the_truth() -> None:
    given = inputs()
    box = {"UA": np.array([4.0]), "kC": np.array([3.0])}
    plain, _ = simulate(box, given)
    for changed in (Bend(heat_w=lambda now: 5.0 + 0.0 * now.air), Bend(reading=lambda now: 1.0 + now.duty)):
        bent, _ = simulate(box, given, bend=changed)
        assert (bent[2:] > plain[2:] + 0.1).all()
    curved, _ = simulate({**box, "ua_curve": np.array([0.5])}, given)
    hot = plain[:, 0] > 21.0 + 15.0  # above CURVE_AT_K a box with a loss that grows is cooler
    assert hot.any()
    assert (curved[hot] < plain[hot]).all()


def test_every_usual_effect_can_be_hidden_and_every_value_is_one_that_the_library_takes() -> None:
    assert set(STRENGTHS) == set(USUAL_EFFECTS) - {"solar_gain"}  # no sun is measured in these suites
    rng = np.random.default_rng(1)
    for name in STRENGTHS:
        own = draw_effect(rng, name)
        assert list(own) == [item.name for item in EFFECTS[name].parameters]
        assert set(own) <= set(NEUTRAL), f"bench/hidden_effects/equations.py does not know {name}"
        assert not any(item.problem(own[item.name]) for item in EFFECTS[name].parameters)


def test_walls_that_lose_their_mass_let_the_same_heat_through() -> None:
    walls = {"wall_mass": {"C_w": 8000.0, "G_in": 12.0, "G_out": 6.0}, "extra_capacity": {"kC": 2.0}}
    assert without(walls, "wall_mass")["wall_loss"] == {"UA": pytest.approx(4.0)}  # 1 / (1/12 + 1/6)
    assert set(adding(without(walls, "wall_mass"), "wall_mass", walls["wall_mass"])) == set(walls)


def test_a_strength_is_found_whose_size_lies_in_the_range_wanted() -> None:
    strengths = np.geomspace(1.0, 100.0, 5)
    for seed in range(20):
        found = strength_for(np.random.default_rng(seed), strengths, 0.1 * strengths, (0.4, 3.0))
        assert found is not None
        assert 0.4 < 0.1 * found < 3.0  # the size is a tenth of the strength


@pytest.mark.parametrize(
    "sizes", [np.full(5, 0.0), np.full(5, 9.0), np.full(5, np.nan), np.geomspace(4, 9, 5)]
)
def test_no_strength_is_found_where_no_size_is_in_range(sizes: np.ndarray) -> None:
    assert strength_for(np.random.default_rng(0), np.geomspace(1.0, 9.0, 5), sizes, (0.4, 3.0)) is None


def test_a_size_counts_recorded_rows_only() -> None:
    difference = np.zeros((BEFORE_ROWS + 12, 2))
    difference[:BEFORE_ROWS] = 99.0  # before the first row
    difference[BEFORE_ROWS + 4 :, 0] = 99.0  # padding after a run of four rows
    difference[BEFORE_ROWS : BEFORE_ROWS + 4, 0] = 2.0
    assert rms_k(difference, (4, 12)) == pytest.approx(1.0)  # sqrt(4 * 2² / 16)


def test_hidden_effects_matter_as_much_as_the_truth_says() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        scene = draw_scene(rng, hard=True)
        if box := hide(rng, scene, ("heater_efficiency",), (0.5, 3.0)):
            break
    assert box is not None
    assert 0.5 <= box.hidden[0].size_k <= 3.0
    assert set(box.true) - set(box.known) == {"heater_efficiency"}


def test_splits_and_kinds_share_no_seed() -> None:
    seeds = [seed_of(split, kind, n) for split in FIRST_SEEDS for kind in KINDS for n in (0, 999)]
    assert len(set(seeds)) == len(seeds)
    with pytest.raises(ValueError, match="null: case 1000"):
        seed_of("dev", "null", 1000)


def test_a_case_is_the_same_for_the_same_seed(root: Path) -> None:
    case = make_case("dev", "hard", 7)
    folder = root / "equations/dev/cases" / case.truth.id
    for name, run in case.train.items():
        there = read_run(folder / name)
        for column, values in run.columns.items():
            np.testing.assert_array_equal(there.columns[column], values)


def test_test_runs_are_given_without_temperatures(root: Path) -> None:
    name = case_id(seed_of("dev", "hard", 7))
    given = read_run(root / "equations/dev/cases" / name / "test_01.csv")
    whole = read_run(root / "equations/dev/truth" / f"{name}_test_01.csv")
    assert given.facts["role"] == "test"
    assert np.isfinite(given.columns["temp_air_c"][:GIVEN_ROWS]).all()
    assert np.isnan(given.columns["temp_air_c"][GIVEN_ROWS:]).all()
    assert np.isfinite(whole.columns["temp_air_c"]).all()
    assert np.isfinite(whole.columns["temp_clean_c"]).all()
    np.testing.assert_array_equal(given.columns["heater_duty"], whole.columns["heater_duty"])


def test_the_truth_lies_outside_the_folder_that_is_given(root: Path) -> None:
    name = case_id(seed_of("dev", "hard", 7))
    document = json.loads((root / "equations/dev/truth" / f"{name}.json").read_text())
    hidden = document["hidden"][0]["name"]
    folder = root / "equations/dev/cases" / name
    assert {path.name for path in folder.iterdir()} == {
        "train_01.csv",
        "train_02.csv",
        "test_01.csv",
        "twin.yaml",
    }
    assert not any(hidden in path.read_text() or "hard" in path.read_text() for path in folder.iterdir())
    assert (document["kind"], document["suite"], document["split"]) == ("hard", "equations", "dev")


def test_the_declared_twin_and_the_true_one_are_twin_files(root: Path) -> None:
    name = case_id(seed_of("dev", "hard", 7))
    declared = read_twin_file(root / "equations/dev/cases" / name / "twin.yaml")
    true = read_twin_file(root / "equations/dev/truth" / f"{name}_true_twin.yaml")
    document = json.loads((root / "equations/dev/truth" / f"{name}.json").read_text())
    assert set(declared.effects) == set(document["known"])
    assert set(true.effects) == set(document["known"]) | {document["hidden"][0]["name"]}
    assert declared.sensor["quantisation_k"] == 0.5


def test_the_true_twin_forecasts_what_the_simulator_makes(root: Path) -> None:
    """Two implementations of the same equations: what is left are the room's noise and steps."""
    name = case_id(seed_of("dev", "hard", 7))
    twin = read_twin_file(root / "equations/dev/truth" / f"{name}_true_twin.yaml").twin()
    truth = json.loads((root / "equations/dev/truth" / f"{name}.json").read_text())["tests"]["test_01.csv"]
    columns = read_run(root / "equations/dev/truth" / f"{name}_test_01.csv").columns
    start = np.array([[truth["start"][state] for state in twin.states]])
    conditions = {"light": "light", "rel_humidity_pct": "rel_humidity"}
    found = twin.rollout(
        start,
        columns["heater_duty"][None, :-1],
        columns["fan_on"][None, :-1],
        columns["temp_ambient_c"][None, :-1],
        conditions={own: columns[key][None, :-1] for key, own in conditions.items() if key in columns},
    )[0]
    assert np.sqrt(np.mean((found - np.array(truth["undisturbed_c"])[1:]) ** 2)) < 0.1


def test_cases_that_are_there_are_kept(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--suite", "equations", "--per-kind", "1", "--out", str(root), "--kinds", "hard"]
    assert make.main([*words, "--seed-from", "7"]) == 0
    assert "1 cases, 1 of them there" in capsys.readouterr().out
    assert make.main([*words[:-1], "soft"]) == 2


def test_spikes_and_holes_are_in_training_runs_after_their_first_rows() -> None:
    for seed in range(20):
        clean, sensing = np.full(120, 25.0), Sensing(0.2, 0.5, hard=True)
        shown_c = read_temps(np.random.default_rng(seed), clean, sensing, "train")
        assert np.abs(shown_c[:GIVEN_ROWS] - 25.0).max() < 1.5
        assert np.isnan(shown_c).any()
        assert np.nanmax(np.abs(shown_c - 25.0)) > 2.0
        np.testing.assert_allclose(shown_c[np.isfinite(shown_c)] % 0.5, 0.0)
        in_test = read_temps(np.random.default_rng(seed), clean, sensing, "test")
        assert np.abs(in_test - 25.0).max() < 1.5  # noise of 0.2 K in steps of 0.5 K


def test_an_effect_outside_the_library_has_no_name_in_it() -> None:
    assert not set(NAMELESS) & set(EFFECTS)
    assert not set(OUTSIDE) & set(EFFECTS)


@pytest.mark.parametrize("name", OUTSIDE)
def test_what_the_chamber_has_and_no_library_changes_what_a_quiet_run_shows(name: str) -> None:
    rng = np.random.default_rng(3)
    base = {**draw_base(rng), **draw_known(rng, "wall_loss")}
    on = np.ones(LEAD_ROWS + 30)
    plan = RunPlan(0.6 * on, 1.0 * on, 0.0 * on, day=1.0, hour=12.0, room_c=21.0, seed=3).shorten(30)
    setting = OUTSIDE[name][0]
    changed = quiet_c({**base, **setting.at(setting.high)}, plan) - quiet_c(base, plan)
    assert np.abs(changed).max() > 0.1


def test_an_offset_of_the_rooms_sensor_matters_to_one_who_believes_it() -> None:
    base = {**draw_base(np.random.default_rng(3)), **draw_known(np.random.default_rng(3), "wall_loss")}
    on = np.ones(LEAD_ROWS + 30)
    plan = RunPlan(0.6 * on, 1.0 * on, 0.0 * on, day=1.0, hour=12.0, room_c=21.0, seed=3).shorten(30)
    offset = {**base, **SETTINGS["ambient_offset"].at(2.0, 1.0)}
    assert quiet_c(offset, plan) == pytest.approx(quiet_c(base, plan))  # nothing happens to the air
    assert believed_c(offset, plan) - believed_c(base, plan) == pytest.approx(2.0, abs=0.1)


def test_the_chamber_without_an_effect_is_the_chamber_before_it() -> None:
    rng = np.random.default_rng(2)
    base = {**draw_base(rng), **draw_known(rng, "wall_loss")}
    on = np.ones(LEAD_ROWS + 12)
    plan = RunPlan(0.5 * on, 0.0 * on, 0.0 * on, day=1.0, hour=12.0, room_c=21.0, seed=3).shorten(12)
    plain = quiet_c(base, plan)
    assert len(plain) == 12
    stronger = [quiet_c({**base, **SETTINGS["heater_efficiency"].at(lost)}, plan)[-1] for lost in (0.1, 0.3)]
    assert plain[-1] > stronger[0] > stronger[1]  # a tenth, three tenths of the heat are lost


def test_what_is_read_off_the_chamber_is_what_was_set() -> None:
    settings = SETTINGS["fan_effectiveness"].at(0.3)
    assert read_off(["fan_effectiveness", "wall_loss"], settings) == {"fan_effectiveness": {"eps_f": 0.7}}
    parameters, effects = chamber_of(settings)
    assert (parameters.fan.effectiveness, effects.fan_effectiveness, effects.wall_loss) == (0.7, 1.0, 0.0)
    for name, own in DIRECT.items():
        assert list(own) == [item.name for item in EFFECTS[name].parameters]
    assert set(SETTINGS) <= set(EFFECTS)
    assert BASE["effects.sensor_noise"] == 1.0


def test_a_plan_at_rest_begins_at_its_first_row_with_what_the_sensors_show() -> None:
    on = np.ones(LEAD_ROWS + 3)
    plan = RunPlan(on, 0.0 * on, 0.0 * on, day=0.0, hour=9.0, room_c=20.0, seed=1)
    assert plan.first == 0
    assert plan.shorten(2).first == LEAD_ROWS
    found = drive({}, plan.shorten(2))
    assert len(found.clean_c) == len(found.shown["temp_ambient_c"]) == 2
    assert found.start["temp_soil_c"] == pytest.approx(found.clean_c[0])


def test_known_effects_of_a_chamber_do_not_hide_what_is_hidden() -> None:
    for name in SETTINGS:
        for seed in range(3):
            known, settings = chamber_cases.draw_known_box(np.random.default_rng(seed), {name})
            assert name not in known
            off = "effects.wall_loss" if name == "wall_mass" else f"effects.{name}"
            assert bool(settings.get(off, 0.0)) is (name == "wall_mass")
