"""edge/diagnosis/fitting.py and unknowns.py: maximum likelihood of several twins over the same runs."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from edge.diagnosis.fitting import fit, slopes
from edge.diagnosis.noise_levels import find_levels
from edge.diagnosis.nuisances import rooms
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial
from edge.diagnosis.unknowns import path_priors, place_unknowns, unknowns, with_effect
from edge.diagnosis.verdict import intervals
from edge.formats.run_file import RecordedRun
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS
from edge.twin.geometry import Geometry
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import BOX, NOISE, Effects, Floats, change_run, simulate, twin_file

pytestmark = pytest.mark.slow

SEEDS = (1, 2, 3)
HIDDEN: Effects = {
    "infiltration": {"F_inf": 0.001},
    "soil_mass": {"C_s": 8000.0, "G_s": 2.0},
    "longwave_radiation": {"epsA": 0.3},
    "heater_lag": {"tau_h": 240.0},
    "heater_deadtime": {"d_h": 75.0},
    "heater_saturation": {"u_sat": 0.7},
    "heater_sag": {"sag": 0.1},
    "fan_effectiveness": {"eps_f": 0.7},
    "fan_spinup": {"tau_f": 60.0},
    "imperfect_mixing": {"F_mix": 0.01},
    "sensor_lag": {"tau_s": 90.0},
    "sensor_bias": {"bias": 0.8},
    "constant_heat": {"P0": 3.0},
    "led_gain": {"P_led": 8.0},
}


def recordings(effects: Effects = BOX, seeds: Sequence[int] = SEEDS, rows: int = 120) -> list[RecordedRun]:
    return [simulate(effects, seed, rows) for seed in seeds]


def arrays(effects: Effects = BOX, seeds: Sequence[int] = SEEDS, rows: int = 120) -> RunBatch:
    return batch_runs(recordings(effects, seeds, rows), 60.0)


def best(name: str, runs: RunBatch, file: TwinFile | None = None) -> FittedTwin:
    """Return the best of a candidate's starts."""
    trials = [Trial(start, NOISE) for start in with_effect(file or twin_file(), name)]
    return max(fit(trials, runs, 15), key=lambda found: found.log_likelihood)


def errors_in_sd(found: FittedTwin, truth: dict[str, float], name: str) -> dict[str, float]:
    """Return the error of each value, in its own coordinate."""
    sds = np.sqrt(np.diag(found.covariance))
    return {
        item.place[2]: (item.coordinate(truth[item.place[2]]) - x) / sd
        for item, x, sd in zip(found.free, found.coordinates, sds, strict=True)
        if item.place[1] == name
    }


def uncertain(effect: str, value: str, rel_sd: float) -> TwinFile:
    """The box with a value of which the file says how well it is known."""
    file = twin_file({**BOX, effect: {value: 0.8}} if effect not in BOX else BOX)
    place = ("effects", effect, value)
    return file.with_values({place: replace(file.values()[place], rel_sd=rel_sd)})


# values and their intervals


@pytest.mark.parametrize("name", HIDDEN)
def test_a_hidden_effect_is_found_again(name: str) -> None:
    truth = dict(HIDDEN[name])
    found = best(name, arrays({**BOX, name: truth}))
    # 16 values in all: of 50 such tables one has a value further off than 3.3 sd.
    assert all(abs(error) < 3.3 for error in errors_in_sd(found, truth, name).values())
    assert intervals(found, name)[1] == ()


@pytest.mark.parametrize("name", ["constant_heat", "fan_effectiveness"])
def test_intervals_are_as_wide_as_what_is_found_scatters(name: str) -> None:
    truth, lots = dict(HIDDEN[name]), 40
    errors = []
    for lot in range(lots):
        runs = arrays({**BOX, name: truth}, seeds=(100 + 2 * lot, 101 + 2 * lot), rows=80)
        errors += errors_in_sd(best(name, runs), truth, name).values()
    low, high = chi2.ppf([0.0005, 0.9995], lots)
    assert low < sum(error**2 for error in errors) < high


def test_what_the_right_twin_leaves_is_white() -> None:
    runs = arrays({**BOX, "heater_lag": {"tau_h": 240.0}})
    white = best("heater_lag", runs).innovations
    low, high = chi2.ppf([0.0005, 0.9995], white.size)
    assert low < (white**2).sum() < high


def test_trials_fitted_side_by_side_come_out_as_alone() -> None:
    runs = arrays({**BOX, "heater_lag": {"tau_h": 240.0}})
    trials = [
        Trial(with_effect(twin_file(), name)[0], NOISE) for name in ("heater_lag", "soil_mass", "sensor_lag")
    ]
    for trial, found in zip(trials, fit(trials, runs), strict=True):
        [alone] = fit([trial], runs)
        assert found.file == alone.file
        assert found.log_likelihood == pytest.approx(alone.log_likelihood)


def test_no_iteration_is_the_file_as_it_is() -> None:
    runs, file = arrays(), with_effect(twin_file(), "heater_lag")[0]
    [found] = fit([Trial(file, NOISE)], runs, 0)
    assert found.file.twin().effects == file.twin().effects
    [better] = fit([Trial(file, NOISE)], runs, 10)
    assert better.log_likelihood > found.log_likelihood


def test_an_iteration_never_makes_it_worse() -> None:
    runs = arrays({**BOX, "imperfect_mixing": {"F_mix": 0.01}})
    trial = Trial(with_effect(twin_file(), "imperfect_mixing")[2], NOISE)  # ten times too much
    likelihoods = [fit([trial], runs, count)[0].log_likelihood for count in (0, 3, 6, 12)]
    # What it goes by is the filter of its start, so that the last tenths of a nat may go the other way.
    assert all(later > before - 0.5 for before, later in pairwise(likelihoods))


def test_holes_and_runs_of_different_lengths_are_fitted_together() -> None:
    truth = {"tau_h": 240.0}
    long, short = recordings({**BOX, "heater_lag": truth}, seeds=(1, 2))
    temps = long.columns["temp_air_c"].copy()
    temps[30:45] = temps[80] = np.nan
    short = RecordedRun({key: values[:70] for key, values in short.columns.items()}, short.facts, short.path)
    found = best("heater_lag", batch_runs([change_run(long, temp_air_c=temps), short], 60.0))
    assert abs(errors_in_sd(found, truth, "heater_lag")["tau_h"]) < 3.3
    assert (found.innovations[0, 29:44] == 0.0).all()
    assert (found.innovations[1, 69:] == 0.0).all()


# bounds


@pytest.mark.parametrize(
    ("name", "truth", "value"),
    [
        ("infiltration", {"wall_loss": {"UA": 3.5}}, ("F_inf", 0.0)),  # it loses less than is known
        ("heater_sag", {"heater_efficiency": {"eta": 1.1}}, ("sag", 0.0)),
        ("heater_saturation", {}, ("u_sat", 1.0)),
        ("extra_capacity", {"extra_capacity": {"kC": 1.0}}, ("kC", 1.0)),
    ],
)
def test_a_value_stays_inside_its_bounds_and_says_that_it_is_at_one(
    name: str, truth: Effects, value: tuple[str, float]
) -> None:
    key, bound = value
    file = twin_file({own: values for own, values in BOX.items() if own != name})
    found = best(name, arrays({**BOX, **truth}), file)
    values, at_bound = intervals(found, name)
    assert values[key].value == pytest.approx(bound, abs=2e-3)
    parameter = EFFECTS[name].parameter(key)
    assert parameter.low <= values[key].low <= values[key].value <= values[key].high <= parameter.high
    if name != "heater_saturation":  # its likelihood is flat above the highest duty: anywhere there
        assert at_bound == (key,)


@pytest.mark.parametrize("name", USUAL_EFFECTS)
def test_every_start_of_a_candidate_is_a_value_it_can_have(name: str) -> None:
    starts = with_effect(twin_file({}), name)
    assert len(starts) == len(EFFECTS[name].starts or starts)
    for file in starts:
        file.twin()  # refuses what is out of bounds
        for item in unknowns(file):
            low, high = item.bounds
            assert low < item.coordinate(file.values()[item.place].value) < high


@pytest.mark.parametrize("name", EFFECTS)
def test_a_coordinate_and_its_value_are_one_to_one_inside_the_bounds(name: str) -> None:
    start = {item.name: Value(item.start, fit=True) for item in EFFECTS[name].parameters}
    for item in unknowns(replace(twin_file(), effects={name: start})):
        low, high = item.bounds
        for coordinate in (low, 0.3 * low + 0.7 * high, high):
            assert item.coordinate(item.value(coordinate)) == pytest.approx(coordinate, abs=1e-9)
        for beyond in (low - 1.0, high + 1.0, -1e6, 1e6):
            assert item.low <= item.value(beyond) <= item.high


# what is known before


def test_what_an_effect_replaces_is_not_moved() -> None:
    file = twin_file({**BOX, "wall_mass": {"C_w": 6000.0, "G_in": 10.0, "G_out": 6.0}})
    place = ("effects", "wall_loss", "UA")
    loose = file.with_values({place: Value(4.0, rel_sd=0.1)})
    assert unknowns(loose) == ()
    assert [item.place for item in unknowns(uncertain("wall_loss", "UA", 0.1))] == [place]


def test_an_uncertain_value_is_moved_between_what_is_known_and_what_the_runs_say() -> None:
    file = uncertain("fan_effectiveness", "eps_f", 0.05)  # 0.8 give or take 0.04
    runs = arrays({**BOX, "fan_effectiveness": {"eps_f": 0.7}})
    [found] = fit([Trial(file, NOISE)], runs, 15)
    value = found.file.effects["fan_effectiveness"]["eps_f"]
    assert 0.69 < value.value < 0.72  # the runs know it to 0.3 %
    assert value.rel_sd == 0.05


def test_an_uncertain_value_of_which_the_runs_say_nothing_stays() -> None:
    still = [change_run(run, fan_on=np.zeros(len(run))) for run in recordings()]
    file = uncertain("fan_effectiveness", "eps_f", 0.05)
    [found] = fit([Trial(file, NOISE)], batch_runs(still, 60.0), 15)
    assert found.file.effects["fan_effectiveness"]["eps_f"].value == pytest.approx(0.8)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.05 * 0.8 / found.free[0].scale)


def test_a_prior_does_not_walk_after_what_was_found_however_often_it_is_fitted() -> None:
    # The prior is far narrower than what two short runs say. Taken anew from the last fit, it would give way
    # a little more each time, until the value were where it is without any: 6 W/K.
    runs = arrays({**BOX, "wall_loss": {"UA": 6.0}}, seeds=(1, 2), rows=40)
    file = uncertain("wall_loss", "UA", 0.01)
    [found] = fit([Trial(file, NOISE)], runs, 15)
    values = []
    for _ in range(6):
        [again] = find_levels([found], file, runs)
        [found] = fit([replace(again, levels=NOISE)], runs, 15)
        assert found.free[0].mean == unknowns(file)[0].mean
        values.append(found.file.effects["wall_loss"]["UA"].value)
    assert values[-1] < 5.0
    assert values[-4:] == pytest.approx([values[-1]] * 4, rel=1e-6)  # the filter's renewal has come to rest


def test_the_films_of_a_wall_give_the_loss_that_is_known() -> None:
    walls = {"C_w": 6000.0, "G_in": 9.0, "G_out": 7.2}  # 1 / (1/9 + 1/7.2) = 4.0
    runs = arrays({**BOX, "wall_mass": walls})
    found = best("wall_mass", runs)
    [off] = path_priors(found.file)
    assert abs(off) < 3.3
    wall = {key: value.value for key, value in found.file.effects["wall_mass"].items()}
    assert 1.0 / (1.0 / wall["G_in"] + 1.0 / wall["G_out"]) == pytest.approx(4.0, rel=0.0165)
    assert all(abs(error) < 3.3 for error in errors_in_sd(found, walls, "wall_mass").values())


@pytest.mark.parametrize(("rel_sd", "sds"), [(None, 0.2231 / 0.005), (0.05, 0.2231 / 0.05)])
def test_films_that_contradict_the_known_loss_are_told_in_its_standard_deviations(
    rel_sd: float | None, sds: float
) -> None:
    # Both films of 10 W/K give 5 W/K where 4 are known: log(5 / 4) = 0.2231.
    file = twin_file({**BOX, "wall_mass": {"C_w": 6000.0, "G_in": 10.0, "G_out": 10.0}})
    known = Value(4.0, rel_sd=rel_sd)
    [off] = path_priors(file.with_values({("effects", "wall_loss", "UA"): known}))
    assert off == pytest.approx(sds, rel=1e-3)


def test_films_are_free_where_the_loss_is_to_be_fitted_or_not_there() -> None:
    walls = {"wall_mass": {"C_w": 6000.0, "G_in": 10.0, "G_out": 10.0}}
    file = twin_file({**BOX, **walls})
    assert path_priors(file.with_values({("effects", "wall_loss", "UA"): Value(4.0, fit=True)})) == []
    assert path_priors(twin_file(walls)) == []
    assert path_priors(twin_file(BOX)) == []


def test_a_geometry_value_that_is_to_be_fitted_is_found() -> None:
    file = replace(twin_file(), geometry={**twin_file().geometry, "heater_max_w": Value(50.0, fit=True)})
    [found] = fit([Trial(file, NOISE)], arrays(), 20)
    # One factor of 1 % a run: of three runs 0.6 %.
    assert found.file.geometry["heater_max_w"].value == pytest.approx(Geometry().heater_max_w, rel=0.02)


# terms


def size_of(term: SizedTerm, runs: RunBatch, file: TwinFile | None = None) -> tuple[float, float]:
    [found] = fit([Trial(file or twin_file(), NOISE, (term,))], runs, 1)
    return float(found.sizes[0]), float(found.size_sds[0])


def test_a_heat_of_known_shape_and_unknown_size_is_found() -> None:
    runs = [simulate(BOX, seed, 120, further=lambda duty, fan, excess: 12.0 * duty * fan) for seed in SEEDS]
    data = batch_runs(runs, 60.0)
    size, sd = size_of(SizedTerm("u fan", (data.duty * data.fan).T, 50.0), data)
    assert abs(size - 12.0) < 3.3 * sd
    assert sd < 1.0


def test_an_error_of_the_reading_is_found_and_not_taken_for_heat() -> None:

    runs = [
        change_run(run, temp_air_c=run.columns["temp_air_c"] + 0.5 * np.roll(run.columns["heater_duty"], 1))
        for run in recordings()
    ]
    data = batch_runs(runs, 60.0)
    size, sd = size_of(SizedTerm("u", data.duty.T, 5.0, of_reading=True), data)
    assert abs(size - 0.5) < 3.3 * sd
    assert sd < 0.05


def test_the_room_of_each_run_is_found_where_none_was_recorded() -> None:
    # A room that stands still is what a constant can replace.
    steady = []
    for seed, room in zip(SEEDS, (18.0, 21.0, 24.0), strict=True):
        run = simulate(BOX, seed, 120)
        shifted = run.columns["temp_air_c"] - run.columns["temp_ambient_c"] + room
        steady.append(change_run(run, temp_air_c=shifted, temp_ambient_c=None))
    data = batch_runs(steady, 60.0)
    guess = np.repeat(data.temp[:, :1], data.duty.shape[1], axis=1)
    data = replace(data, ambient=guess)
    [found] = fit([Trial(twin_file(), NOISE, rooms(data))], data, 1)
    # The room's swing of 1.5 K is taken off the air as if it followed at once: within some tenths.
    assert found.sizes + guess[:, 0] == pytest.approx([18.0, 21.0, 24.0], abs=0.6)


def test_a_term_is_worth_what_its_best_size_is_worth() -> None:
    # Taken off the readings at its best size, it leaves the same likelihood but for its prior.
    runs = arrays()
    term = SizedTerm("u", runs.duty.T, 0.3, of_reading=True)
    [found] = fit([Trial(twin_file(), NOISE, (term,))], runs, 1)
    temp = runs.temp.copy()
    temp[:, 1:] -= found.sizes[0] * runs.duty
    [plain] = fit([Trial(twin_file(), NOISE)], replace(runs, temp=temp), 1)
    prior = 0.5 * (found.sizes[0] / 0.3) ** 2
    assert found.log_likelihood == pytest.approx(plain.log_likelihood - prior, abs=1e-6)
    assert found.innovations == pytest.approx(plain.innovations, abs=1e-9)


def test_what_moves_with_a_twin_can_be_frozen_into_terms() -> None:
    # A linear unknown: its term is worth what it is worth itself, and its size is what it moves by.
    file = twin_file({**BOX, "constant_heat": {"P0": 0.0}})
    loose = file.with_values({("effects", "constant_heat", "P0"): Value(0.0, fit=True)})
    runs = arrays({**BOX, "constant_heat": {"P0": 3.0}})
    [at_zero] = fit([Trial(loose, NOISE)], runs, 0)
    terms = tuple(slopes(at_zero, runs))
    [moved], [frozen] = fit([Trial(loose, NOISE)], runs, 10), fit([Trial(file, NOISE, terms)], runs, 1)
    assert [term.name for term in terms] == ["effects.constant_heat.P0"]
    assert frozen.log_likelihood == pytest.approx(moved.log_likelihood, abs=0.02)
    scale = moved.free[0].scale
    assert float(frozen.sizes[0]) * scale == pytest.approx(
        moved.file.effects["constant_heat"]["P0"].value, rel=1e-3
    )


def test_placing_keeps_how_a_value_is_known() -> None:
    file = uncertain("fan_effectiveness", "eps_f", 0.05)
    free = unknowns(file)
    moved: Floats = np.array([free[0].coordinate(0.6)])
    value = place_unknowns(file, free, moved).effects["fan_effectiveness"]["eps_f"]
    assert value == Value(0.6, rel_sd=0.05)
