"""The evidence of bets: rarely large where nothing is there, large where something is."""

import numpy as np
import pytest

from fleet.rollout.judge import MOST, evidence_above, evidence_below

ERROR, BOUND, MARGIN, LOOKS = 0.05, 0.5, 0.1, 200


def two_points(rng: np.random.Generator, mean: float) -> list[float]:
    """Values at both ends of the range, the worst case of a given mean."""
    return np.where(rng.random(LOOKS) < 0.5 + mean / (2.0 * BOUND), BOUND, -BOUND).tolist()


@pytest.mark.parametrize("spread", ["two points", "narrow", "skewed"])
def test_false_alarms_over_all_looks_stay_within_the_error(spread: str) -> None:
    rng, alarms, runs = np.random.default_rng(7), 0, 1000
    for _ in range(runs):
        if spread == "two points":
            values = two_points(rng, MARGIN)
        elif spread == "narrow":
            values = np.clip(rng.normal(MARGIN, 0.1, LOOKS), MARGIN - 0.4, MARGIN + 0.4).tolist()
        else:  # seldom much, mean MARGIN
            values = np.where(rng.random(LOOKS) < 0.2, BOUND, 0.0).tolist()
        alarms += evidence_above(values, MARGIN, BOUND) >= 1.0 / ERROR
    # Ville: at most 5 %; 50 + 3 standard deviations of 6.9
    assert alarms <= 71


def test_both_sides_are_bounded_at_the_margin_itself() -> None:
    rng = np.random.default_rng(8)
    alarms = sum(evidence_below(two_points(rng, MARGIN), MARGIN, BOUND) >= 1.0 / ERROR for _ in range(1000))
    assert alarms <= 71


def test_harm_is_found_and_safety_is_found() -> None:
    rng = np.random.default_rng(9)
    worse = np.clip(rng.normal(0.35, 0.1, 40), -BOUND, BOUND).tolist()
    as_good = np.clip(rng.normal(0.0, 0.1, 60), -BOUND, BOUND).tolist()
    assert evidence_above(worse, MARGIN, BOUND) > 1.0 / ERROR
    assert evidence_below(worse, MARGIN, BOUND) < 2.0
    assert evidence_below(as_good, MARGIN, BOUND) > 1.0 / ERROR
    assert evidence_above(as_good, MARGIN, BOUND) < 2.0


def test_evidence_never_falls_with_more_values_and_begins_at_one() -> None:
    rng = np.random.default_rng(10)
    values = two_points(rng, 0.3)
    path = [evidence_above(values[:count], MARGIN, BOUND) for count in range(LOOKS)]
    assert path[0] == 1.0
    assert path == sorted(path)


@pytest.mark.parametrize("wrong", [float("nan"), 0.6, -0.6, float("inf")])
def test_a_value_outside_the_bound_is_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="not within"):
        evidence_above([0.1, wrong], MARGIN, BOUND)


def test_months_of_evidence_stay_a_number() -> None:
    assert evidence_below([-BOUND] * 5000, MARGIN, BOUND) == MOST
