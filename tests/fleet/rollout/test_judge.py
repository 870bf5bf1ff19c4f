"""The verdict on a wave from costs of boxes."""

import numpy as np
import pytest

from fleet.rollout.begin import KindRigs, choose_wave, wave_size
from fleet.rollout.judge import (
    BLOCK_H,
    BOUND,
    HOUR_S,
    MOST,
    HourCost,
    JudgeRules,
    Verdict,
    difference,
    evidence_above,
    evidence_below,
    judge,
    relative_change,
)

RULES = JudgeRules(margin=0.1, error=0.05, waves=3)
ERROR, BET_BOUND, MARGIN, LOOKS = 0.05, 0.5, 0.1, 200


def hours(first: float, costs: list[float]) -> list[HourCost]:
    return [HourCost(first + HOUR_S * k, cost) for k, cost in enumerate(costs)]


def test_a_block_is_compared_with_the_same_hours_of_the_days_before() -> None:
    day = [1.0] * 12 + [2.0] * 12
    before, begin = hours(0.0, day + day), 48 * HOUR_S
    noon = begin + 12 * HOUR_S
    after = hours(begin, [1.0] * 12 + [3.0] * 12)
    assert relative_change(after, before, begin) == pytest.approx(0.0)
    assert relative_change(after, before, noon) == pytest.approx(0.5)


def test_a_block_that_lacks_an_hour_has_no_value() -> None:
    before, begin = hours(0.0, [1.0] * 24), 24 * HOUR_S
    after = hours(begin, [1.0] * BLOCK_H)
    assert relative_change(after[1:], before, begin) is None
    assert relative_change(after, [], begin) is None


def test_one_odd_box_counts_no_more_than_the_bound() -> None:
    assert difference([90.0, 0.0], [0.0, 0.0]) == BOUND / 2
    assert difference([90.0, 9.0], [-0.5, -0.5]) == BOUND
    assert difference([0.1, 0.3], [0.0, 0.1]) == pytest.approx(0.15)
    assert difference([0.1], [0.0, 0.1]) is None


def drawn(mean: float, blocks: int, seed: int) -> list[float]:
    return np.clip(np.random.default_rng(seed).normal(mean, 0.08, blocks), -BOUND, BOUND).tolist()


def test_one_bad_kind_stops_a_wave_and_is_named() -> None:
    found = judge({"tent": drawn(0.0, 24, 1), "case": drawn(0.4, 24, 2)}, RULES)
    assert found.verdict is Verdict.WORSE
    assert "kind case is dearer by 4" in found.why or "kind case is dearer by 3" in found.why


def test_a_good_wave_is_shown_not_worse_but_not_before_a_day() -> None:
    good = {"tent": drawn(0.0, 60, 1), "case": drawn(-0.05, 60, 2)}
    assert judge(good, RULES).verdict is Verdict.NOT_WORSE
    early = {kind: values[: RULES.least_blocks - 1] for kind, values in good.items()}
    assert judge(early, RULES).verdict is Verdict.WAIT


def test_a_wave_that_nothing_is_known_of_waits_and_names_the_kinds() -> None:
    found = judge({"tent": [], "": []}, RULES)
    assert (found.verdict, found.why) == (Verdict.WAIT, "not shown to be within 10%: -, tent")


def test_false_stops_over_all_looks_and_kinds_stay_within_the_error() -> None:
    rng, stops, runs = np.random.default_rng(3), 0, 400
    for _ in range(runs):
        # Both ends of the range, mean at the margin: as bad as a bundle that shall not be stopped can be.
        share = 0.5 + RULES.margin / (2.0 * BOUND)
        blocks = np.where(rng.random((3, 60)) < share, BOUND, -BOUND)
        found = judge(dict(zip("abc", blocks.tolist(), strict=True)), RULES)
        stops += found.verdict is Verdict.WORSE
    # a third of 5 % for one of three waves: 6.7 of 400, and 3 standard deviations of 2.6
    assert stops <= 14


def rigs(kind: str, count: int) -> list[str]:
    return [f"{kind}-{number}" for number in range(count)]


def test_a_large_fleet_goes_by_shares() -> None:
    # 1 % of 2000 is 20; 10 % are 200, of which 20 have it; then all the rest
    assert wave_size(1, 2000, 0, 2000) == 20
    assert wave_size(2, 2000, 20, 1980) == 180
    assert wave_size(3, 2000, 200, 1800) == 1800


def test_a_small_kind_has_six_new_boxes_in_each_wave_and_as_many_wait() -> None:
    assert wave_size(1, 20, 0, 20) == 6
    assert wave_size(2, 20, 6, 14) == 6
    assert wave_size(1, 6, 0, 6) == 3
    assert wave_size(1, 1, 0, 1) == 0
    assert wave_size(3, 1, 0, 1) == 1


def test_a_wave_is_chosen_within_each_kind_and_the_same_at_each_call() -> None:
    kinds = {kind: KindRigs(20, rigs(kind, 20)) for kind in ("tent", "case")}
    first = choose_wave(1, kinds, {}, "rollout 1")
    assert first == choose_wave(1, kinds, {}, "rollout 1")
    assert first != choose_wave(1, kinds, {}, "rollout 2")
    assert sorted(name.partition("-")[0] for name in first) == ["case"] * 6 + ["tent"] * 6
    assert len(set(first)) == 12


def test_all_rigs_have_had_their_turn_after_the_last_wave() -> None:
    waiting, reached = {"tent": rigs("tent", 37), "odd": rigs("odd", 1)}, {"tent": 0, "odd": 0}
    totals = {kind: len(names) for kind, names in waiting.items()}
    for wave in (1, 2, 3):
        kinds = {kind: KindRigs(totals[kind], names) for kind, names in waiting.items()}
        for name in choose_wave(wave, kinds, reached, "x"):
            kind = name.partition("-")[0]
            waiting[kind].remove(name)
            reached[kind] += 1
    assert waiting == {"tent": [], "odd": []}


def two_points(rng: np.random.Generator, mean: float) -> list[float]:
    """Values at both ends of the range, the worst case of a given mean."""
    return np.where(rng.random(LOOKS) < 0.5 + mean / (2.0 * BET_BOUND), BET_BOUND, -BET_BOUND).tolist()


@pytest.mark.parametrize("spread", ["two points", "narrow", "skewed"])
def test_false_alarms_over_all_looks_stay_within_the_error(spread: str) -> None:
    rng, alarms, runs = np.random.default_rng(7), 0, 1000
    for _ in range(runs):
        if spread == "two points":
            values = two_points(rng, MARGIN)
        elif spread == "narrow":
            values = np.clip(rng.normal(MARGIN, 0.1, LOOKS), MARGIN - 0.4, MARGIN + 0.4).tolist()
        else:  # seldom much, mean MARGIN
            values = np.where(rng.random(LOOKS) < 0.2, BET_BOUND, 0.0).tolist()
        alarms += evidence_above(values, MARGIN, BET_BOUND) >= 1.0 / ERROR
    # Ville: at most 5 %; 50 + 3 standard deviations of 6.9
    assert alarms <= 71


def test_both_sides_are_bounded_at_the_margin_itself() -> None:
    rng = np.random.default_rng(8)
    alarms = sum(
        evidence_below(two_points(rng, MARGIN), MARGIN, BET_BOUND) >= 1.0 / ERROR for _ in range(1000)
    )
    assert alarms <= 71


def test_harm_is_found_and_safety_is_found() -> None:
    rng = np.random.default_rng(9)
    worse = np.clip(rng.normal(0.35, 0.1, 40), -BET_BOUND, BET_BOUND).tolist()
    as_good = np.clip(rng.normal(0.0, 0.1, 60), -BET_BOUND, BET_BOUND).tolist()
    assert evidence_above(worse, MARGIN, BET_BOUND) > 1.0 / ERROR
    assert evidence_below(worse, MARGIN, BET_BOUND) < 2.0
    assert evidence_below(as_good, MARGIN, BET_BOUND) > 1.0 / ERROR
    assert evidence_above(as_good, MARGIN, BET_BOUND) < 2.0


def test_evidence_never_falls_with_more_values_and_begins_at_one() -> None:
    rng = np.random.default_rng(10)
    values = two_points(rng, 0.3)
    path = [evidence_above(values[:count], MARGIN, BET_BOUND) for count in range(LOOKS)]
    assert path[0] == 1.0
    assert path == sorted(path)


@pytest.mark.parametrize("wrong", [float("nan"), 0.6, -0.6, float("inf")])
def test_a_value_outside_the_bound_is_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="not within"):
        evidence_above([0.1, wrong], MARGIN, BET_BOUND)


def test_months_of_evidence_stay_a_number() -> None:
    assert evidence_below([-BET_BOUND] * 5000, MARGIN, BET_BOUND) == MOST
