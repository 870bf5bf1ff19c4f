"""edge/diagnosis/search.py: sets of effects by what they are worth, on runs with one or two hidden."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from edge.diagnosis.candidates import ScoredSet
from edge.diagnosis.search import RIVAL_NATS, Round, Search
from edge.formats.run_file import RecordedRun
from edge.twin.value import Value
from tests.support.simulated_runs import (
    BOX,
    Effects,
    candidates_only,
    change_run,
    search_over,
    simulate,
    twin_file,
)

pytestmark = pytest.mark.slow

# Enough to be mistaken for each other, few enough to be fast; test_twin_diagnose.py tries them all.
CANDIDATES = (
    *("wall_loss", "infiltration", "soil_mass", "extra_capacity", "heater_lag", "heater_deadtime"),
    *("heater_efficiency", "fan_effectiveness", "short_circuit", "sensor_lag", "constant_heat", "led_gain"),
)
HIDDEN: Effects = {
    "heater_lag": {"tau_h": 200.0},
    "infiltration": {"F_inf": 0.0015},
    "soil_mass": {"C_s": 8000.0, "G_s": 2.0},
    "fan_effectiveness": {"eps_f": 0.8},
}
RUNS, ROWS = 4, 60  # time goes with the rows of a run, not with how many there are
LAG, LAG_AND_LEAK, WEAK_FAN = ("heater_lag",), ("heater_lag", "infiltration"), ("fan_effectiveness",)


@pytest.fixture(autouse=True, scope="module")
def few_candidates() -> Iterator[None]:
    with candidates_only(*CANDIDATES):
        yield


def runs_with(hidden: Effects, first_seed: int = 1) -> list[RecordedRun]:
    return [simulate({**BOX, **hidden}, first_seed + i, ROWS) for i in range(RUNS)]


@cache
def searched(names: tuple[str, ...] = (), first_seed: int = 1) -> tuple[Search, ScoredSet]:
    """With these effects hidden; kept, as a search does not change what it has found."""
    search, _ = search_over(runs_with({name: HIDDEN[name] for name in names}, first_seed))
    return search, search.missing()


@pytest.mark.parametrize("first_seed", [1, 11])
def test_nothing_is_added_where_nothing_is_missing(first_seed: int) -> None:
    assert searched(first_seed=first_seed)[1].added == frozenset()


@pytest.mark.parametrize("names", [LAG, ("soil_mass",), LAG_AND_LEAK], ids=" and ".join)
def test_what_is_hidden_is_found_and_nothing_else(names: tuple[str, ...]) -> None:
    search, best = searched(names)
    assert best.added == set(names)
    assert best.score > search.sets.base().score
    for name in names:
        found = best.fit.file.effects[name]
        values = {key: value.value for key, value in found.items()}
        assert values == pytest.approx(dict(HIDDEN[name]), rel=0.15)


def test_a_heat_that_no_effect_gives_is_a_formula_not_a_name() -> None:
    runs = [simulate(BOX, seed, ROWS, further=lambda u, fan, _: 15.0 * u * fan) for seed in range(1, 5)]
    search, shapes = search_over(runs)
    best = search.missing()
    assert best.added == {"~u fan"}
    place = [term.name for term in best.fit.trial.nuisances].index("~u fan")
    assert abs(best.fit.sizes[place] - 15.0) < 3.3 * best.fit.size_sds[place]
    assert shapes["~u fan"].unit == "W"


# rivals


def likelihoods(sets: Sequence[ScoredSet]) -> dict[str, float]:
    return {" ".join(sorted(item.added)): item.likelihood for item in sets}


def test_two_names_of_one_flow_are_as_likely_as_each_other() -> None:
    # eps_f is 1 - s_sc: no data ever tell them apart.
    search, best = searched(WEAK_FAN)
    [own] = best.added
    [other] = {"fan_effectiveness", "short_circuit"} - {own}
    near = likelihoods(search.rivals(best, [own])[own])
    assert near.pop(other) == pytest.approx(best.likelihood, abs=0.1)
    assert all(value < best.likelihood - RIVAL_NATS for value in near.values())


def test_a_leak_looks_like_a_loss_where_the_fan_never_runs() -> None:
    runs = [simulate(BOX, seed, ROWS, fan=False) for seed in range(1, 5)]
    search, _ = search_over(runs, twin_file({"extra_capacity": {"kC": 10.0}}))
    best = search.missing()
    [own] = best.added
    [other] = {"wall_loss", "infiltration"} - {own}
    assert likelihoods(search.rivals(best, [own])[own])[other] == pytest.approx(best.likelihood, abs=0.1)


class Misled(Search):
    """A search that is shown the leak first, then a wrong second, then for once nothing."""

    __slots__ = ()
    OFFERED = ("infiltration", "sensor_lag", "")

    def _grow(self, beside: ScoredSet) -> list[ScoredSet]:
        turn = len(self.rounds)
        if turn >= len(self.OFFERED):
            return Search._grow(self, beside)
        self.rounds.append(Round(beside.added, ()))
        return self._looked_at(
            beside, [x for x in self.screening.beside(beside) if x.name == self.OFFERED[turn]]
        )


def test_a_member_that_another_explains_better_is_exchanged() -> None:
    right, best = searched(LAG_AND_LEAK)
    misled = Misled(right.file, right.runs, right.progress, right.nuisances, right.formulas)
    assert misled.missing().added == best.added
    assert [turn.beside for turn in misled.rounds[:3]] == [
        *({*()}, {"infiltration"}, {"infiltration", "sensor_lag"}),
    ]


# what may be missing


def test_candidates_are_what_the_file_has_not_and_the_runs_have_columns_for() -> None:
    search, _ = searched()
    assert set(search.candidates.names) == set(CANDIDATES) - set(BOX)
    dark, _ = search_over([change_run(run, light=None) for run in runs_with({})])
    assert set(search.candidates.names) - set(dark.candidates.names) == {"led_gain"}


def test_a_door_is_a_candidate_only_where_one_was_found() -> None:
    search, _ = searched()
    opened = {**search.runs.conditions, "door_open": np.zeros_like(search.runs.duty)}
    runs = replace(search.runs, conditions=opened)
    with candidates_only("door_opening"):
        assert Search(search.file, search.runs, search.progress).candidates.names == []
        assert Search(search.file, runs, search.progress).candidates.names == ["door_opening"]


def test_a_loss_that_a_wall_replaces_is_no_candidate() -> None:
    wall = {"wall_mass": {"C_w": 5000.0, "G_in": 10.0, "G_out": 8.0}}
    search, _ = searched()
    assert "wall_loss" not in Search(twin_file(wall), search.runs, search.progress).candidates.names


def test_what_has_more_values_or_more_rivals_has_to_explain_more() -> None:
    search, _ = searched()
    values, candidates = 0.5 * np.log(search.candidates.rows), np.log(len(search.candidates.names))
    assert search.penalty("heater_lag") == pytest.approx(values + candidates)
    assert search.penalty("soil_mass") == pytest.approx(2.0 * values + candidates)
    # Of the three values of a wall the known loss gives one.
    assert search.penalty("wall_mass") == pytest.approx(2.0 * values + candidates)
    rows = search.runs.duty.shape[1]
    with_doors = replace(search.candidates, doors=3)
    assert with_doors.penalty("door_opening") == pytest.approx(
        search.penalty("door_opening") + 3 * np.log(6.0 * rows)
    )
    assert with_doors.penalty("heater_lag") == search.penalty("heater_lag")
    assert search.penalty("~u fan") > values + np.log(len(search.formulas))


def test_rounds_tell_what_was_tried_the_most_promising_first() -> None:
    search, _ = searched(LAG)
    first = search.rounds[0]
    assert first.beside == frozenset()
    assert first.candidates[0].name == "heater_lag"
    worth = [item.score_gain for item in first.candidates]
    assert worth == sorted(worth, reverse=True)
    assert set(search.candidates.names) <= {item.name for item in first.candidates}
    for item in first.candidates:
        assert item.score_gain == pytest.approx(item.gain_nats - search.penalty(item.name))


def test_a_set_that_was_fitted_is_not_fitted_again() -> None:
    search, best = searched(LAG)
    assert search.sets.base() is search.sets.base()
    assert search.sets.without(best, "heater_lag") is search.sets.base()


def test_an_uncertain_value_keeps_its_prior_through_the_search() -> None:
    file = twin_file({**BOX, "fan_effectiveness": {"eps_f": 0.8}})
    loose = file.with_values({("effects", "fan_effectiveness", "eps_f"): Value(0.8, rel_sd=0.05)})
    hidden = {name: HIDDEN[name] for name in (*WEAK_FAN, *LAG)}
    search, _ = search_over(runs_with(hidden), loose)
    best = search.missing()
    assert best.added == {"heater_lag"}
    [own] = [item for item in best.fit.free if item.place[1] == "fan_effectiveness"]
    [given] = [item for item in search.sets.base().fit.free if item.place[1] == "fan_effectiveness"]
    assert (own.mean, own.sd) == (given.mean, given.sd)
    assert own.mean * own.scale == pytest.approx(0.8)
