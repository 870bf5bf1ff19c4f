"""edge/diagnosis/verdict.py: how sure a name is, and what is said of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from edge.diagnosis.candidates import ScoredSet
from edge.diagnosis.fitting import fit
from edge.diagnosis.formulas import shapes
from edge.diagnosis.search import RIVAL_NATS
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial
from edge.diagnosis.unknowns import unknowns, with_effect
from edge.diagnosis.verdict import (
    MOST_SURE,
    DiagnosisVerdict,
    evidence,
    interval,
    intervals,
    probability,
    verdict,
)
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile
from tests.support.simulated_runs import BOX, NOISE, simulate, twin_file

SHAPE = {f"~{shape.text}": shape for shape in shapes()}
NO_RUNS = RunBatch(np.full((1, 3), 21.0), np.zeros((1, 2)), np.zeros((1, 2)), np.full((1, 2), 21.0))


@dataclass
class FinishedSearch:
    """A search that has come to its end. left : scores by set; near : rivals by member"""

    best: ScoredSet
    left: Mapping[frozenset[str], float] = field(default_factory=dict)
    near: Mapping[str, list[ScoredSet]] = field(default_factory=dict)
    vague: ScoredSet | None = None
    alone: Mapping[frozenset[str], ScoredSet] = field(default_factory=dict)
    file: TwinFile = field(default_factory=twin_file)
    runs: RunBatch = NO_RUNS

    @property
    def sets(self) -> "FinishedSearch":
        return self

    def missing(self) -> ScoredSet:
        return self.best

    def formulas_alone(self) -> ScoredSet:
        assert self.vague is not None
        return self.vague

    def without(self, item: ScoredSet, name: str) -> ScoredSet:
        less = item.added - {name}
        return self.alone.get(less, replace(item, added=less))

    def worth(self, item: ScoredSet, names: Sequence[str]) -> dict[str, float]:
        return {name: item.score - self.left.get(item.added - {name}, 0.0) for name in names}

    def rivals(self, item: ScoredSet, names: Sequence[str]) -> dict[str, list[ScoredSet]]:
        return {name: self.near.get(name, []) for name in names}


def fitted(*names: str, variance: float = 1e-4, terms: tuple[SizedTerm, ...] = ()) -> FittedTwin:
    """Effects at their usual values, as if a fit had ended there."""
    file = twin_file()
    for name in names:
        file = with_effect(file, name)[0]
    free = unknowns(file)
    values = file.values()
    place = np.array([item.coordinate(values[item.place].value) for item in free])
    sizes = np.arange(1.0, len(terms) + 1.0)
    trial = Trial(file, NOISE, terms)
    return FittedTwin(
        *(trial, file, free, place, 0.0, variance * np.eye(len(free)), np.zeros((1, 2)), sizes, 0.1 * sizes)
    )


def scored(*names: str, likelihood: float = 100.0, score: float = 100.0) -> ScoredSet:
    terms = tuple(SizedTerm(name, np.zeros((2, 1)), 1.0) for name in names if name.startswith("~"))
    effects = [name for name in names if not name.startswith("~")]
    return ScoredSet(frozenset(names), fitted(*effects, terms=terms), likelihood, score)


def read(found: FinishedSearch) -> DiagnosisVerdict:
    return verdict(found, SHAPE)  # type: ignore[arg-type]


def test_effects_come_in_the_order_of_what_they_are_worth() -> None:
    best = scored("heater_lag", "infiltration", "soil_mass")
    worth = {best.added - {name}: left for name, left in
             (("heater_lag", 60.0), ("infiltration", 10.0), ("soil_mass", 85.0))}  # fmt: skip
    said = read(FinishedSearch(best, worth))
    assert said.kind == "named"
    assert [effect.name for effect in said.effects] == ["infiltration", "heater_lag", "soil_mass"]
    assert [effect.log_odds for effect in said.effects] == [90.0, 40.0, 15.0]
    assert said.depends_on == ()
    assert said.formula == ()


@pytest.mark.parametrize(
    ("behind", "is_one"),
    [(-1.0, True), (0.0, True), (RIVAL_NATS, True), (RIVAL_NATS + 0.01, False), (50.0, False)],
)
def test_what_explains_the_runs_as_well_is_an_alternative(behind: float, is_one: bool) -> None:
    near = {"heater_lag": [scored("heater_deadtime", likelihood=100.0 - behind)]}
    [effect] = read(FinishedSearch(scored("heater_lag"), near=near)).effects
    assert dict(effect.alternatives) == ({"heater_deadtime": -behind} if is_one else {})


def test_alternatives_come_the_likeliest_first_and_a_formula_is_none() -> None:
    near = [
        *(scored("sensor_lag", likelihood=98.0), scored("heater_deadtime", likelihood=99.5)),
        *(scored("extra_capacity", likelihood=99.0), scored("~u fan", likelihood=99.9)),
    ]
    [effect] = read(FinishedSearch(scored("heater_lag"), near={"heater_lag": near})).effects
    assert list(effect.alternatives) == ["heater_deadtime", "extra_capacity", "sensor_lag"]


def test_an_alternative_is_told_of_the_member_in_whose_place_it_stands() -> None:
    best = scored("heater_lag", "fan_effectiveness")
    near = {"fan_effectiveness": [scored("heater_lag", "short_circuit")]}
    said = {
        effect.name: list(effect.alternatives) for effect in read(FinishedSearch(best, near=near)).effects
    }
    assert said == {"heater_lag": [], "fan_effectiveness": ["short_circuit"]}


# unknown


def test_a_formula_worth_more_than_any_name_is_unknown_and_says_what_it_depends_on() -> None:
    best = scored("~u fan", "infiltration")
    said = read(FinishedSearch(best, {frozenset({"infiltration"}): 10.0, frozenset({"~u fan"}): 90.0}))
    assert said.kind == "unknown"
    assert said.effects == ()
    assert said.depends_on == ("heater_duty", "fan_on")
    [term] = said.formula
    # Made up: size 1 with a standard deviation of 0.1.
    assert (term.text, term.unit, term.value) == ("u fan", "W", 1.0)
    assert (term.low, term.high) == pytest.approx((1.0 - 0.196, 1.0 + 0.196), abs=1e-3)
    assert said.final is best


def test_dependences_of_two_formulas_are_said_once_the_strongest_first() -> None:
    best = scored("~t (T - T_amb)", "~u fan")
    said = read(FinishedSearch(best, {frozenset({"~u fan"}): 10.0, frozenset({"~t (T - T_amb)"}): 90.0}))
    assert said.depends_on == ("time", "temp_air", "heater_duty", "fan_on")
    assert [term.text for term in said.formula] == ["t (T - T_amb)", "u fan"]


def test_a_name_worth_more_than_the_formula_beside_it_is_named() -> None:
    best = scored("~u fan", "infiltration")
    said = read(FinishedSearch(best, {frozenset({"infiltration"}): 90.0, frozenset({"~u fan"}): 10.0}))
    assert said.kind == "named"
    assert [effect.name for effect in said.effects] == ["infiltration"]
    assert [term.text for term in said.formula] == ["u fan"]


def errors_that_follow(share: float) -> np.ndarray:
    """One run's innovations, each with so much of the one before it."""
    found = np.random.default_rng(1).standard_normal(4000)
    for k in range(1, len(found)):
        found[k] += share * found[k - 1]
    return found[None]


@pytest.mark.parametrize(
    ("share", "kind"), [(0.0, "named"), (0.40, "named"), (0.50, "unknown"), (0.9, "unknown")]
)
def test_a_name_that_leaves_errors_which_follow_from_each_other_is_none(share: float, kind: str) -> None:
    best = scored("infiltration")
    best = replace(best, fit=replace(best.fit, innovations=errors_that_follow(share)))
    vague = scored("~t (T - T_amb)", score=50.0)
    said = read(FinishedSearch(best, vague=vague))
    assert said.kind == kind
    assert said.depends_on == (("time", "temp_air") if kind == "unknown" else ())
    assert said.final is (vague if kind == "unknown" else best)


def test_where_no_formula_explains_such_errors_either_it_depends_on_nothing_known() -> None:
    best = scored("infiltration")
    loud = errors_that_follow(0.8)
    best, plain = (replace(item, fit=replace(item.fit, innovations=loud)) for item in (best, scored()))
    said = read(FinishedSearch(best, vague=plain))
    assert (said.kind, said.effects, said.depends_on) == ("unknown", (), ("none",))


def test_rows_that_were_not_measured_refute_nothing() -> None:
    best = scored("infiltration")
    holes = errors_that_follow(0.9)
    holes[0, ::2] = 0.0
    found = FinishedSearch(replace(best, fit=replace(best.fit, innovations=holes)))
    assert read(found).kind == "named"


def test_values_beside_a_formula_are_those_of_the_twin_that_has_none() -> None:
    best = scored("~u fan", "infiltration")
    alone = scored("infiltration")
    there = replace(alone.fit, coordinates=alone.fit.coordinates + 0.5)
    alone = replace(alone, fit=there)
    left = {frozenset({"infiltration"}): 90.0, frozenset({"~u fan"}): 10.0}
    said = read(FinishedSearch(best, left, alone={frozenset({"infiltration"}): alone}))
    assert said.effects[0].parameters == intervals(there, "infiltration")[0]
    assert said.effects[0].parameters != intervals(best.fit, "infiltration")[0]


@pytest.mark.parametrize(("heat_w", "kind"), [(NOISE.heat_w, "nothing_missing"), (15.0, "unknown")])
def test_heat_that_no_set_explains_is_unknown_too(heat_w: float, kind: str) -> None:
    runs = batch_runs([simulate(BOX, seed, 60, replace(NOISE, heat_w=heat_w)) for seed in (1, 2, 3, 4)], 60.0)
    [plain] = fit([Trial(twin_file(), replace(NOISE, heat_w=heat_w))], runs, 1)
    said = read(FinishedSearch(ScoredSet(frozenset(), plain, 0.0, 0.0), runs=runs))
    assert said.kind == kind
    assert said.effects == ()
    assert said.depends_on == (("none",) if kind == "unknown" else ())


# values


def test_values_come_with_95_percent_intervals_in_their_own_coordinate() -> None:
    values, at_bound = intervals(fitted("heater_lag", "heater_sag", variance=0.01), "heater_lag")
    # tau_h moves by its logarithm: 40 s times or by exp(1.96 * 0.1).
    assert values["tau_h"].value == pytest.approx(40.0)
    assert values["tau_h"].low == pytest.approx(40.0 / np.exp(0.196), rel=1e-3)
    assert values["tau_h"].high == pytest.approx(40.0 * np.exp(0.196), rel=1e-3)
    assert at_bound == ()


def test_an_interval_ends_at_the_bounds() -> None:
    values, _ = intervals(fitted("heater_sag", variance=100.0), "heater_sag")
    assert (values["sag"].low, values["sag"].high) == (0.0, 0.5)


@pytest.mark.parametrize(("share", "at_bound"), [(0.0, True), (0.0005, True), (0.002, False), (0.5, False),
                                                 (0.998, False), (0.9995, True), (1.0, True)])  # fmt: skip
def test_a_value_at_its_bound_is_told(share: float, at_bound: bool) -> None:
    found = fitted("heater_sag")
    low, high = found.free[0].bounds
    there = replace(found, coordinates=np.array([low + share * (high - low)]))
    assert intervals(there, "heater_sag")[1] == (("sag",) if at_bound else ())


@pytest.mark.parametrize("variance", [0.0, -1e-12])
def test_a_variance_that_rounding_made_negative_is_none(variance: float) -> None:
    [item] = fitted("heater_sag").free
    value = interval(item, 0.5, variance)
    assert value.low == value.value == value.high


# how sure a name is


def sure(nats: float = 30.0, with_k: float = 0.1, without_k: float = 0.5) -> float:
    return probability(evidence(nats, with_k, without_k))


def test_more_evidence_is_never_less_sure() -> None:
    assert sure(nats=5.0) < sure(nats=20.0) <= sure(nats=80.0)
    assert sure(without_k=0.11) < sure(without_k=0.2) <= sure(without_k=2.0)


def test_nothing_is_certain() -> None:
    assert sure(nats=1e9, without_k=1e6) == MOST_SURE
    assert 0.0 <= sure(nats=-50.0, with_k=5.0, without_k=5.0) < 0.1


def test_odd_numbers_are_no_error() -> None:
    for numbers in ((0.0, 0.0, 1.0), (1.0, 1e-12, 1.0), (-1.0, 1e9, 1.0)):
        assert 0.0 <= probability(evidence(*numbers)) <= MOST_SURE
