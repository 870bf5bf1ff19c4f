"""The structure of a kind: of several that its boxes told, the one that follows the recordings of all."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import DiagnosisRuns
from edge.diagnosis.unknowns import settle, with_usual
from edge.twin.provenance import provenance_numbers
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from fleet.priors.fleet_prior import BoxSheet, fit_prior
from fleet.priors.kind_structure import (
    ANY_HEAT,
    CONVECTION,
    MOST_JOINED,
    Fits,
    Rehearsals,
    choose,
    fit_structure,
    in_kind_structure,
    loss_shares,
    structures,
)
from fleet.priors.rehearsal import Rehearsal
from tests.support.simulated_runs import BOX, simulate, twin_file

LAG, SOIL, BOTH = ("heater_lag",), ("soil_mass",), ("soil_mass", "heater_lag")
SLOW = ("soil_mass", "slow_mass", "heater_lag")


def told(rig: str, *names: str, kind: str = "tent", miss_k: float = 0.3) -> BoxSheet:
    values = {"heater_lag": {"tau_h": Value(300.0)}, "soil_mass": {"C_s": Value(3e3), "G_s": Value(3.0)}}
    effects = {"wall_loss": {"UA": Value(2.4)}, "extra_capacity": {"kC": Value(4.0)}}
    effects |= {"fan_effectiveness": {"eps_f": Value(0.5)}}
    usual = {name: settle(with_usual(twin_file(), name)).effects[name] for name in names}
    effects |= {**usual, **{name: values[name] for name in names if name in values}}
    provenance = {"after": {"train": {"rmse_k": miss_k}}}
    return BoxSheet(rig, kind, replace(twin_file(), effects=effects, provenance=provenance))


def fits(misses_k: dict[tuple[str, tuple[str, ...]], float]) -> Fits:
    return {(rig, names): told(rig, *names, miss_k=miss).twin for (rig, names), miss in misses_k.items()}


def also_bent(*plain: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return structures, and each with natural convection."""
    return sorted([*plain, *((*own, CONVECTION) for own in plain)])


def in_structure(sheets: list[BoxSheet], known: Fits) -> list[BoxSheet]:
    return in_kind_structure(sheets, known, choose(sheets, known, {}))


def test_each_structure_that_was_told_is_one_of_its_kind_and_so_is_what_two_have_told_together() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", kind=""), told("d", kind="case")]
    assert structures(sheets) == {"tent": also_bent(LAG, SOIL, BOTH, SLOW), "case": also_bent(())}


def test_of_many_that_were_told_the_simplest_are_joined() -> None:
    names = ("heater_lag", "soil_mass", "heater_sag", "fan_spinup", "sensor_lag", "heater_derating")
    sheets = [told(name, name) for name in names]
    sheets += [told(f"{name} again", name) for name in names]
    sheets.append(told("once", "imperfect_mixing", "heater_lag"))
    wanted = structures(sheets)["tent"]
    assert {(name,) for name in names} <= {*wanted}
    joined = [own for own in wanted if len({*own} - {CONVECTION}) == 2]
    assert len(joined) == 2 * (MOST_JOINED + 1)


def test_a_slow_body_is_tried_beside_one_that_was_told_and_beside_all_else() -> None:
    assert structures([told("a", "heater_lag")])["tent"] == also_bent(LAG)
    two = [told("a", "soil_mass", "heater_lag"), told("b", "soil_mass")]
    assert structures(two)["tent"] == also_bent(SOIL, BOTH, SLOW)
    # A new box tells the twin that it began with.
    assert structures([told("a", *SLOW), told("b", *SLOW)])["tent"] == also_bent(SLOW)


def test_what_was_told_with_convection_is_tried_as_it_is_told() -> None:
    (bent,) = {*also_bent(LAG)} - {LAG}
    assert structures([told("a", *bent)])["tent"] == [bent]
    assert structures([told("a", *bent), told("b", *LAG)])["tent"] == also_bent(LAG)


def test_the_structure_that_follows_all_boxes_is_the_kinds() -> None:
    sheets = [told("a", "soil_mass"), told("b", "heater_lag"), told("c", "soil_mass")]
    # Most have told soil, but a lag follows each of them better.
    known = fits({(rig, LAG): 0.2 for rig in "abc"} | {(rig, SOIL): 0.4 for rig in "abc"})
    shared = in_structure(sheets, known)
    assert [sheet.rig for sheet in shared] == ["a", "b", "c"]
    assert all("heater_lag" in sheet.twin.effects for sheet in shared)
    assert fit_prior(shared).structure("tent") == LAG


def test_a_simpler_structure_that_is_nearly_as_good_is_taken() -> None:
    sheets = [told("a", "heater_lag"), told("b", "heater_lag", "soil_mass")]
    known = fits({(rig, LAG): 0.205 for rig in "ab"} | {(rig, BOTH): 0.2 for rig in "ab"})
    assert all("soil_mass" not in sheet.twin.effects for sheet in in_structure(sheets, known))
    known = fits({(rig, LAG): 0.25 for rig in "ab"} | {(rig, BOTH): 0.2 for rig in "ab"})
    assert all("soil_mass" in sheet.twin.effects for sheet in in_structure(sheets, known))


def rehearsed(misses_k: dict[tuple[str, ...], float], rigs: str = "abc") -> Rehearsals:
    """Return the same for each box. misses_k : by structure"""
    return {(rig, names): Rehearsal(own) for names, own in misses_k.items() for rig in rigs}


def test_the_structure_is_one_in_which_an_hour_foretells_the_rest() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", "heater_lag")]
    known = fits({(rig, names): 0.2 for rig in "abc" for names in (LAG, SOIL)})
    assert choose(sheets, known, {}) == {"tent": LAG}
    assert choose(sheets, known, rehearsed({LAG: 0.6, SOIL: 0.4})) == {"tent": SOIL}
    assert choose(sheets, known, rehearsed({LAG: 0.4, SOIL: 0.6})) == {"tent": LAG}
    # It need not be the one that follows what was recorded.
    known = fits({(rig, LAG): 0.1 for rig in "abc"} | {(rig, SOIL): 0.3 for rig in "abc"})
    assert choose(sheets, known, rehearsed({LAG: 0.6, SOIL: 0.4})) == {"tent": SOIL}


@pytest.mark.parametrize(("closer", "other"), [(LAG, BOTH), (BOTH, LAG)])
def test_of_structures_that_foretell_alike_one_that_follows_recordings_much_better_is_taken(
    closer: tuple[str, ...], other: tuple[str, ...]
) -> None:
    sheets = [told("a", "heater_lag"), told("b", *BOTH), told("c", "heater_lag")]
    known = fits({(rig, closer): 0.2 for rig in "abc"} | {(rig, other): 0.4 for rig in "abc"})
    alike = rehearsed({closer: 0.51, other: 0.5}, "abcd")
    assert choose(sheets, known, alike) == {"tent": closer}
    little = fits({(rig, closer): 0.2 for rig in "abc"} | {(rig, other): 0.22 for rig in "abc"})
    assert choose(sheets, little, alike) == {"tent": LAG}
    # One whose readings are made up does not say which that is.
    sheets.append(told("d", "heater_lag"))
    known |= fits({("d", closer): 1.0, ("d", other): 1e-9})
    assert choose(sheets, known, alike) == {"tent": closer}


@pytest.mark.parametrize("lie_k", [1e-9, 1e3])
def test_a_box_that_lies_does_not_outvote_rehearsals_of_three(lie_k: float) -> None:
    sheets = [*(told(rig, "heater_lag") for rig in "abc"), told("d", "soil_mass")]
    known = fits({(rig, names): 0.2 for rig in "abcd" for names in (LAG, SOIL)})
    honest = rehearsed({LAG: 0.3, SOIL: 0.6})
    lies = {("d", LAG): Rehearsal(1e3), ("d", SOIL): Rehearsal(lie_k)}
    assert choose(sheets, known, honest | lies) == {"tent": LAG}


def test_what_was_rehearsed_in_part_is_compared_as_far_as_it_goes() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", "heater_lag")]
    known = fits({(rig, names): 0.2 for rig in "abc" for names in (LAG, SOIL)})
    alone = rehearsed({LAG: 0.3, SOIL: 0.1}, "a")
    assert choose(sheets, known, alone) == {"tent": LAG}
    two = rehearsed({LAG: 0.6, SOIL: 0.2}, "ab")
    assert choose(sheets, known, two) == {"tent": SOIL}


def test_boxes_that_were_not_fitted_tell_what_they_told() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", "soil_mass", kind="case")]
    assert in_structure(sheets, {}) == [sheets[2], *sheets[:2]]
    # One alone is nothing to compare with.
    known = {("a", LAG): 0.2, ("a", SOIL): 0.4}
    assert in_structure(sheets, fits(known)) == [sheets[2], *sheets[:2]]
    # Of a kind of which some are fitted the others tell nothing: their values are of other things.
    sheets.append(told("d", "soil_mass"))
    known |= {("d", LAG): 0.2, ("d", SOIL): 0.4}
    shared = in_structure(sheets, fits(known))
    assert [(sheet.rig, "heater_lag" in sheet.twin.effects) for sheet in shared] == [
        ("c", False), ("a", True), ("d", True),
    ]  # fmt: skip


def test_a_box_that_was_fitted_before_another_structure_was_told_tells_its_values() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", "heater_lag")]
    known = {(rig, LAG): 0.2 for rig in "abc"} | {(rig, SOIL): 0.4 for rig in "ab"}
    assert [sheet.rig for sheet in in_structure(sheets, fits(known))] == ["a", "b", "c"]


def test_a_structure_that_cannot_be_fitted_is_in_nobodys_way() -> None:
    sheets = [told("a", "heater_lag"), told("b", "soil_mass"), told("c", "heater_lag", "soil_mass")]
    known = fits({(rig, LAG): 0.2 for rig in "abc"} | {(rig, SOIL): 0.4 for rig in "abc"})
    assert all({*sheet.twin.effects} >= {*LAG} for sheet in in_structure(sheets, known))
    assert len(in_structure(sheets, known)) == 3


@pytest.mark.parametrize("miss_k", [1e-9, np.inf])
def test_a_box_with_readings_that_are_made_up_outvotes_no_three(miss_k: float) -> None:
    sheets = [*(told(rig, "heater_lag") for rig in "abc"), told("liar", "soil_mass")]
    known = {(rig, LAG): 0.2 for rig in "abc"} | {(rig, SOIL): 0.4 for rig in "abc"}
    known |= {("liar", LAG): max(miss_k, 0.2), ("liar", SOIL): min(miss_k, 0.1)}
    assert all("heater_lag" in sheet.twin.effects for sheet in in_structure(sheets, fits(known)))


def recorded(hidden: dict[str, dict[str, float]], rows: int = 360) -> tuple[TwinFile, DiagnosisRuns]:
    file = twin_file()
    return file, history_runs([simulate({**BOX, **hidden}, 1, rows)], file)


@pytest.mark.slow
def test_values_in_a_structure_are_those_of_the_recording() -> None:
    twin = fit_structure(*recorded({"heater_lag": {"tau_h": 400.0}}), LAG)
    assert twin.effects["heater_lag"]["tau_h"].value == pytest.approx(400.0, rel=0.15)
    assert ANY_HEAT not in twin.effects and twin.to_fit() == []
    # No fit saw the test part, so the figure says how well its kind can be followed.
    (train_k,), (test_k,) = (provenance_numbers(twin, "after", part, "rmse_k") for part in ("train", "test"))
    assert 0.0 < train_k < 0.2 and 0.0 < test_k < 0.3


@pytest.mark.slow
def test_a_slow_body_is_no_loss_of_the_box() -> None:
    hidden = {"soil_mass": {"C_s": 9000.0, "G_s": 4.0}, "slow_mass": {"C_m": 150_000.0, "G_m": 3.0}}
    file, runs = recorded(hidden, rows=720)
    one, two = (fit_structure(file, runs, names).effects for names in (SOIL, SLOW[:2]))
    # One body for both takes a third of what the slow one stores for a loss.
    assert one["wall_loss"]["UA"].value > 1.2 * BOX["wall_loss"]["UA"]
    assert two["wall_loss"]["UA"].value == pytest.approx(BOX["wall_loss"]["UA"], rel=0.1)
    assert two["soil_mass"]["C_s"].value == pytest.approx(9000.0, rel=0.25)
    assert two["slow_mass"]["C_m"].value == pytest.approx(150_000.0, rel=0.3)


@pytest.mark.slow
def test_a_heat_of_its_place_is_no_loss_of_the_box() -> None:
    hidden = {"heater_lag": {"tau_h": 400.0}, ANY_HEAT: {"P0": 10.0}}
    twin = fit_structure(*recorded(hidden), LAG)
    assert twin.effects[ANY_HEAT]["P0"].value == pytest.approx(10.0, rel=0.3)
    assert twin.effects["wall_loss"]["UA"].value == pytest.approx(BOX["wall_loss"]["UA"], rel=0.15)
    sheets = [BoxSheet(rig, "tent", twin) for rig in "ab"]
    start = fit_prior(sheets).start(twin_file(), "tent")
    assert ANY_HEAT not in start.effects
    ua = start.effects["wall_loss"]["UA"]
    assert np.isclose(ua.value, twin.effects["wall_loss"]["UA"].value, rtol=0.05)


@pytest.mark.parametrize(
    ("shares", "share"),
    [([], 1.0), ([0.8], 0.8**0.25), ([0.8, 0.9], 0.72**0.2), ([0.8, 0.9, 2.0, 0.9, 0.9], 0.9**0.625)],
)
def test_the_loss_over_days_is_that_of_rehearsed_boxes_and_one_that_lies_moves_little(
    shares: list[float], share: float
) -> None:
    sheets = [told(str(i), "heater_lag") for i in range(len(shares))]
    known = {(str(i), LAG): Rehearsal(0.3, own) for i, own in enumerate(shares)}
    other = {("0", SOIL): Rehearsal(0.3, 2.0)}
    assert loss_shares(sheets, {"tent": LAG}, known | other) == {"tent": pytest.approx(share)}
