import numpy as np
import pytest
from rk45 import rk45_rollout

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.models.pbm import Pbm
from edge.twin.fit import fit_twin
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import PastColumns, at_rest, state_now
from training.models.twin_step import TwinStep

ROWS, COMING = 60, 20
LOSS = {"wall_loss": {"UA": 5.0}, "extra_capacity": {"kC": 4.0}}
LATE = {"heater_deadtime": {"d_h": 100.0}, "fan_deadtime": {"d_f": 30.0}, "fan_spinup": {"tau_f": 40.0}}
BENT = {"longwave_radiation": {"epsA": 0.5}, "evapotranspiration": {"k_e": 10.0}, "led_gain": {"P_led": 20.0}}
HIDDEN = {
    "soil_mass": {"C_s": 9000.0, "G_s": 4.0},
    "sensor_lag": {"tau_s": 60.0},
    "heater_lag": {"tau_h": 200.0},
}
TWINS = {
    "late": {**LOSS, **LATE},
    "bent": {**LOSS, **BENT},
    "hidden": {**LOSS, **HIDDEN, "ambient_offset": {"b_amb": 0.5}},
    "all": {
        **LOSS,
        **LATE,
        **BENT,
        **HIDDEN,
        "imperfect_mixing": {"F_mix": 0.05},
        "sensor_bias": {"bias": 0.4},
    },
}


def recorded(effects, seed=0):
    """Columns of ROWS + COMING + 1 rows of a box of these effects."""
    rng, rows = np.random.default_rng(seed), ROWS + COMING
    twin = BoxTwin(effects=effects)
    columns = {
        "temp_ambient": 21.0 + 0.1 * rng.normal(size=rows).cumsum(),
        "heater_duty": np.repeat(rng.uniform(0.0, 0.8, rows // 5), 5),
        "fan_on": np.repeat((rng.uniform(size=rows // 4) < 0.3) * 1.0, 4),
        "light": np.repeat((rng.uniform(size=rows // 20) < 0.5) * 1.0, 20),
        "rel_humidity": rng.uniform(50.0, 70.0, rows),
    }
    temps = twin.rollout(
        at_rest(twin, 23.0, 21.0),
        columns["heater_duty"][None],
        columns["fan_on"][None],
        columns["temp_ambient"],
        conditions=columns,
    )[0]
    return columns | {"temp_air": np.append(23.0, temps)}


def cut(columns, rows):
    return {name: column[rows] for name, column in columns.items()}


def controls_of(columns):
    return np.stack([columns["heater_duty"], columns["fan_on"]], axis=-1)[None]


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
def test_a_forecast_from_history_is_what_the_box_then_does(effects):
    columns = recorded(effects)
    past, coming = cut(columns, slice(ROWS + 1)), cut(columns, slice(ROWS, ROWS + COMING))
    forecast = Pbm(BoxTwin(effects=effects)).rollout(past, controls_of(coming), coming)[0]
    np.testing.assert_allclose(forecast, columns["temp_air"][ROWS + 1 :], atol=0.02)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
def test_a_batch_is_its_rows(effects):
    columns, model = recorded(effects), Pbm(BoxTwin(effects=effects))
    past, coming = cut(columns, slice(ROWS + 1)), cut(columns, slice(ROWS, ROWS + COMING))
    controls = np.random.default_rng(1).uniform(size=(4, COMING, 2)).round()
    together = model.rollout(past, controls, coming)
    for row in range(4):
        alone = model.rollout(past, controls[row : row + 1], coming)[0]
        np.testing.assert_allclose(together[row], alone, atol=1e-9)


def test_a_command_from_before_the_start_still_arrives():
    # 10 W for the 45 s of a dead time that reach into the step, 180.9 J/K
    twin = BoxTwin(effects={"heater_deadtime": {"d_h": 45.0}})
    none = np.zeros((1, 2))
    before = Commands(np.array([0.5, 0.1]), np.zeros(2))
    temps = twin.rollout(np.array([21.0]), none, none, 21.0, before=before)[0]
    np.testing.assert_allclose(temps, 21.0 + 10.0 * 45.0 / (1.2 * 1005.0 * 0.15))


@pytest.mark.parametrize("rows", [1, 2])
def test_a_history_of_a_row_or_two_is_enough(rows):
    columns, model = recorded(TWINS["all"]), Pbm(BoxTwin(effects=TWINS["all"]))
    past, coming = cut(columns, slice(rows)), cut(columns, slice(COMING))
    assert np.isfinite(model.rollout(past, controls_of(coming), coming)).all()


@pytest.mark.parametrize("column", ["light", "rel_humidity"])
@pytest.mark.parametrize("where", ["history", "ahead"])
def test_a_column_that_is_missing_is_named(column, where):
    columns, model = recorded(TWINS["all"]), Pbm(BoxTwin(effects=TWINS["all"]))
    given = {"history": cut(columns, slice(ROWS + 1)), "ahead": cut(columns, slice(ROWS, ROWS + COMING))}
    controls = controls_of(given["ahead"])
    del given[where][column]
    with pytest.raises(DataError, match=f"^{column}: missing, the twin's "):
        model.rollout(given["history"], controls, given["ahead"])


def test_holes_in_the_history_are_bridged_and_ahead_gives_no_number():
    columns, model = recorded(TWINS["all"]), Pbm(BoxTwin(effects=TWINS["all"]))
    past, coming = cut(columns, slice(ROWS + 1)), cut(columns, slice(ROWS, ROWS + COMING))
    past = {name: column.copy() for name, column in past.items()}
    for column in past.values():
        column[[3, 20, -1]] = np.nan
    assert np.isfinite(model.rollout(past, controls_of(coming), coming)).all()
    coming = coming | {"light": np.where(np.arange(COMING) < 5, coming["light"], np.nan)}
    known = np.isfinite(model.rollout(past, controls_of(coming), coming)[0])
    np.testing.assert_array_equal(known, np.arange(COMING) < 5)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
def test_an_offset_is_carried_on(effects):
    """A box with nothing but capacity keeps what is added; here it fades, but not by the next step."""
    columns, model = recorded(effects), Pbm(BoxTwin(effects=effects))
    past, coming = cut(columns, slice(ROWS + 1)), cut(columns, slice(ROWS, ROWS + COMING))
    controls = np.zeros((1, COMING, 2))
    moved = model.rollout(past, controls, coming | {"offset": np.full(COMING, 0.1)})
    off = (moved - model.rollout(past, controls, coming))[0]
    assert off[0] == pytest.approx(0.1)
    assert 0.1 < off[1] < 0.2


def test_heat_put_in_is_stored_or_lost_with_late_commands_and_radiation():
    """Joules over an hour: C dT = eta H t - UA sum - radiated, from the temperatures at steps of 1 s."""
    effects = {**LOSS, "heater_deadtime": {"d_h": 600.0}, "longwave_radiation": {"epsA": 0.5}}
    twin, seconds = BoxTwin(effects=effects, step_s=1.0), 3600
    temps = twin.rollout(np.array([24.0]), np.full((1, seconds), 0.6), np.zeros((1, seconds)), 21.0)[0]
    temps = np.append(24.0, temps)
    stored = 4.0 * 1.2 * 1005.0 * 0.15 * (temps[-1] - 24.0)
    fourth = (temps + 273.15) ** 4 - (21.0 + 273.15) ** 4
    lost = np.trapezoid(5.0 * (temps - 21.0) + 0.5 * 5.670374419e-8 * fourth)
    assert stored + lost == pytest.approx(60.0 * (3600.0 - 600.0), rel=1e-5)


def test_parameters_of_late_bent_and_lit_effects_come_back():
    true = {
        **LOSS,
        "heater_deadtime": {"d_h": 75.0},
        "led_gain": {"P_led": 20.0},
        "sensor_lag": {"tau_s": 80.0},
    }
    runs = []
    for seed in range(3):
        columns = recorded(true, seed)
        noisy = columns["temp_air"][:-1] + np.random.default_rng(seed).normal(0.0, 0.02, ROWS + COMING)
        names = {"temp_ambient": "temp_ambient_c", "rel_humidity": "rel_humidity_pct"}
        own = {names.get(name, name): column for name, column in columns.items() if name != "temp_air"}
        runs.append(RecordedRun(own | {"time_s": 60.0 * np.arange(ROWS + COMING), "temp_air_c": noisy}))
    start = {name: {key: Value(0.7 * v, fit=True) for key, v in own.items()} for name, own in true.items()}
    found = fit_twin(TwinFile(effects=start), runs).file.effects
    for name, own in true.items():
        for key, value in own.items():
            assert found[name][key].value == pytest.approx(value, rel=0.05), (name, key)


def test_days_are_counted_from_the_first_run():
    times = {"time_s": 60.0 * np.arange(30), "temp_ambient_c": np.full(30, 21.0), "fan_on": np.zeros(30)}
    twin, runs = BoxTwin(effects={**LOSS, "ua_drift": {"ua_drift": 0.2}}, day0_utc=0.0), []
    for day in (2, 0, 5):
        duty = np.repeat([0.6, 0.2, 0.4], 10)
        utc = 86400.0 * day + times["time_s"][:-1]
        temps = twin.rollout(
            np.array([22.0]), duty[None, :-1], np.zeros((1, 29)), 21.0, conditions={"utc": utc}
        )
        own = {"temp_air_c": np.append(22.0, temps[0]), "heater_duty": duty}
        runs.append(RecordedRun(times | own, {"start_utc": f"1970-01-{1 + day:02d}T00:00:00Z"}))
    effects = {"wall_loss": {"UA": Value(4.0, fit=True)}, "extra_capacity": {"kC": Value(4.0)}}
    file = fit_twin(TwinFile(effects=effects | {"ua_drift": {"ua_drift": Value(0.05, fit=True)}}), runs).file
    assert file.day0_utc == 0.0
    assert file.effects["wall_loss"]["UA"].value == pytest.approx(5.0, rel=1e-3)
    assert file.effects["ua_drift"]["ua_drift"].value == pytest.approx(0.2, rel=1e-2)


def test_the_filter_finds_soil_behind_a_slow_sensor():
    effects = TWINS["hidden"]
    columns, twin = recorded(effects), BoxTwin(effects=effects)
    state = at_rest(twin, 23.0, 21.0) + np.array([0.0, 0.0, 3.0, 0.0])
    true = [state]
    for k in range(ROWS):
        inputs = (columns[name][k] for name in ("temp_ambient", "heater_duty", "fan_on"))
        true.append(twin.advance(true[-1], *inputs))
    past = cut(columns, slice(ROWS + 1)) | {"temp_air": np.array(true)[:, 0]}
    named = (past[name] for name in ("temp_air", "temp_ambient", "heater_duty", "fan_on"))
    assert twin.states == ("sensor", "air", "soil", "heater")
    np.testing.assert_allclose(state_now(twin, PastColumns(*named)), true[-1], atol=0.2)


def test_the_plain_reference_refuses_a_twin_of_late_inputs():
    with pytest.raises(DataError, match=r"^twin: has effects on its inputs"):
        rk45_rollout(BoxTwin(effects=TWINS["late"]), np.array([22.0]), *np.zeros((3, 2)))


def test_a_graph_of_plain_inputs_refuses_a_twin_of_late_ones_and_names_them():
    with pytest.raises(
        DataError, match=r"^twin: heater_deadtime, fan_deadtime, fan_spinup: acts on the inputs"
    ):
        TwinStep.of(BoxTwin(effects=TWINS["late"]))
