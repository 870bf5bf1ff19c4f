"""Values of boxes about their kind: what a kind is like, how odd ones weigh, what few boxes tell."""

import numpy as np
import pytest

from fleet.priors.population import fit_population

Drawn = tuple[list[float], list[float], list[str]]


def drawn(seed: int, kinds: int, boxes: int, between: float, within: float, error: float = 0.01) -> Drawn:
    rng = np.random.default_rng(seed)
    values, names = [], []
    for kind in range(kinds):
        centre = 1.0 + between * rng.normal()
        values += [centre + np.hypot(within, error) * rng.normal() for _ in range(boxes)]
        names += [f"kind-{kind}"] * boxes
    return values, [error] * len(values), names


def test_the_spreads_that_values_were_drawn_with_come_out() -> None:
    found = fit_population(*drawn(1, kinds=60, boxes=8, between=0.6, within=0.1))
    assert found.between == pytest.approx(0.6, rel=0.2)
    # The scale of Student's t with four degrees of freedom is 0.8 of the spread of normal values.
    assert found.within == pytest.approx(0.08, rel=0.2)
    assert found.mean == pytest.approx(1.0, abs=0.2)


def test_the_prior_of_a_kind_holds_new_boxes_of_it() -> None:
    inside = 0
    for seed in range(40):
        values, errors, names = drawn(seed, kinds=10, boxes=5, between=0.6, within=0.15)
        prior = fit_population(values[1:], errors[1:], names[1:]).of_kind("kind-0")
        inside += abs(values[0] - prior.mean) < 1.96 * prior.sd
    assert inside >= 34  # of 40, where 38 are right on average


def test_errors_of_the_boxes_own_twins_are_not_their_spread() -> None:
    found = fit_population(*drawn(5, kinds=40, boxes=10, between=0.6, within=0.1, error=0.4))
    assert found.within < 0.25
    assert found.between == pytest.approx(0.6, rel=0.25)


def test_a_value_that_its_box_hardly_knows_moves_nothing() -> None:
    values, errors, names = drawn(6, kinds=5, boxes=4, between=0.6, within=0.1)
    clean = fit_population(values, errors, names).of_kind("kind-0")
    unsure = fit_population([*values, values[0] - 1.0], [*errors, 1.5], [*names, "kind-0"]).of_kind("kind-0")
    assert unsure.mean == pytest.approx(clean.mean, abs=0.03)
    assert unsure.sd == pytest.approx(clean.sd, rel=0.1)


def test_one_odd_box_hardly_moves_its_kind() -> None:
    values, errors, names = drawn(3, kinds=10, boxes=6, between=0.6, within=0.1)
    clean = fit_population(values, errors, names).of_kind("kind-0")
    odd = fit_population([values[0] + 3.0, *values[1:]], errors, names).of_kind("kind-0")
    assert abs(odd.mean - clean.mean) < 0.15
    assert odd.sd < 2.0 * clean.sd


def test_a_kind_that_is_new_is_told_what_the_whole_fleet_tells() -> None:
    found = fit_population(*drawn(4, kinds=20, boxes=4, between=0.6, within=0.1))
    prior = found.of_kind("never seen")
    assert prior.mean == found.mean
    assert prior.sd > found.between


def test_one_box_alone_leaves_much_open() -> None:
    prior = fit_population([0.5], [0.01], ["tent"]).of_kind("tent")
    assert prior.mean == pytest.approx(0.5)
    assert prior.sd > 0.2
