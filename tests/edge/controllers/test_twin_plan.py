"""The twin's step as matrices, the state that is followed, and the beam against every plan there is."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.controllers.mixed_integer.problem import FanRules, PlanningProblem
from edge.controllers.mpc_twin import (
    CLASH_WEIGHT,
    HORIZON,
    StepInputs,
    _held_from_tail,
    band_before_steps,
    begin,
    correct_belief,
    fan_shares,
    measurement_sd_k,
    move_belief,
    never_flat,
    wait_after_heat,
)
from edge.controllers.twin_plan.beam import KIND_K, PlanStart, _cheapest, _Children, search
from edge.controllers.twin_plan.linear_step import linear_step
from edge.core.controller import ControlLimits
from edge.core.names import HEATER_LEVELS
from edge.models.pbm import read_twin
from edge.twin.model import BoxTwin, StateNoise
from edge.twin.rollout import Commands
from edge.twin.warm_start import at_rest

DIAGNOSED = Path("training/results/paper_case/interpolation/twin.yaml")
WALL = {"wall_loss": {"UA": 3.0}, "extra_capacity": {"kC": 5.0}}
ROOM_C = 21.0


@pytest.fixture(scope="module")
def diagnosed() -> BoxTwin:
    return read_twin(DIAGNOSED).twin


def step_of(twin: BoxTwin, temp: float = 25.0):
    return linear_step(twin, at_rest(twin, temp, ROOM_C), ROOM_C, {})


def test_the_matrices_make_the_twins_own_step(diagnosed):
    step, rng = step_of(diagnosed), np.random.default_rng(1)
    state = at_rest(diagnosed, 26.0, ROOM_C) + rng.normal(size=len(diagnosed.states))
    for fan_before, fan in itertools.product((0, 1), repeat=2):
        before, now, ambient = 0.35, 0.8, 22.5
        march = diagnosed.march(
            Commands(np.array([[now]]), np.array([[float(fan)]])),
            np.array([[ambient]]),
            before=Commands(np.array([[before]]), np.array([[float(fan_before)]])),
        )
        mode = step.mode(fan_before, fan)
        mine = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * ambient
        mine += step.now[mode] * step.share_of(now) + step.late[mode] * step.share_of(before)
        np.testing.assert_allclose(mine, march.step(0, state[None])[0], atol=1e-9)


def test_heat_into_the_air_warms_it():
    twin = BoxTwin(effects=WALL)
    step, decay = step_of(twin), 60.0 * 3.0 / twin.system.air_capacity_j_k
    assert step.heat[0, step.air] == pytest.approx((1.0 - np.exp(-decay)) / decay)  # the loss takes its part


def follow(twin: BoxTwin, minutes: int, extra_k: float, holes: bool = False):
    """A box that is the twin but for a constant heat, followed from its readings."""
    step, state = step_of(twin), at_rest(twin, 23.0, ROOM_C)
    belief = begin(twin, 0.0, 23.0, ROOM_C)
    for k in range(minutes):
        mode = 0
        state = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * ROOM_C
        state = state + step.now[mode] * 0.3 + step.heat[mode] * extra_k
        state = state + step.late[mode] * (0.3 if k else 0.0)
        inputs = StepInputs(0.3, 0.0, 0.3 if k else 0.0, 0.0, ROOM_C)
        belief = move_belief(belief, twin, step, inputs, 60.0 * (k + 1))
        belief = correct_belief(belief, float("nan") if holes and k % 2 else float(state[0]), step.shown)
    return belief, state


@pytest.mark.parametrize("holes", [False, True])
def test_the_disturbance_is_found(diagnosed, holes):
    belief, state = follow(diagnosed, 240, 0.1, holes)
    assert belief.disturbance == pytest.approx(0.1, abs=0.02)
    assert belief.state[0] == pytest.approx(state[0], abs=0.02)


@pytest.mark.parametrize(("step_k", "chases"), [(0.0, True), (0.5, False)])
def test_a_sensor_in_coarse_steps_is_not_followed_from_step_to_step(step_k, chases):
    """The same box and twin, read in steps of 0.5 K by a twin that knows it and one that does not."""
    twin = BoxTwin(effects=WALL, noise=StateNoise(step_k=step_k))
    step, state, last = step_of(twin), at_rest(twin, 23.0, ROOM_C), 0.0
    belief, missed = begin(twin, 0.0, 23.0, ROOM_C), []
    for k in range(180):
        duty = 0.06 if k // 30 % 2 else 0.1
        state = step.matrix[0] @ state + step.constant[0] + step.room[0] * ROOM_C + step.now[0] * duty
        belief = move_belief(belief, twin, step, StepInputs(duty, 0.0, last, 0.0, ROOM_C), 60.0 * (k + 1))
        shown_c = 0.5 * round(2.0 * float(state[0]))
        belief, last = correct_belief(belief, shown_c, step.shown, measurement_sd_k(twin)), duty
        missed.append(belief.state[0] - state[0])
    assert (np.abs(missed[30:]).max() > 0.2) == chases


def test_an_open_door_teaches_less_than_its_size(diagnosed):
    belief, _ = follow(diagnosed, 60, 0.0)
    little = correct_belief(belief, belief.state[0] - 0.2, 0).disturbance - belief.disturbance
    much = correct_belief(belief, belief.state[0] - 20.0, 0).disturbance - belief.disturbance
    assert much < 0.0
    assert much / little < 5.0


@pytest.mark.parametrize(("loss_w_k", "widens"), [(3.0, False), (9.0, True)])
def test_a_twin_that_misfits_follows_its_box(loss_w_k, widens):
    """A box that loses 3 or 9 W/K, followed by a twin of 3 W/K while heat comes and goes."""
    twin = BoxTwin(effects=WALL)
    box = BoxTwin(effects={**WALL, "wall_loss": {"UA": loss_w_k}})
    mine, its, state = step_of(twin), step_of(box), at_rest(box, 23.0, ROOM_C)
    belief, missed, last = begin(twin, 0.0, 23.0, ROOM_C), [], 0.0
    for k in range(120):
        duty = 0.6 if k // 15 % 2 else 0.1
        state = its.matrix[0] @ state + its.constant[0] + its.room[0] * ROOM_C + its.now[0] * duty
        belief = move_belief(belief, twin, mine, StepInputs(duty, 0.0, last, 0.0, ROOM_C), 60.0 * (k + 1))
        missed.append(belief.state[0] - state[0])
        belief, last = correct_belief(belief, float(state[0]), mine.shown), duty
    assert (belief.misfit > 2.0) == widens
    assert np.abs(missed[60:]).max() < 1.0  # the box warms by 6 K a step of full heat


def test_heat_beyond_a_saturation_still_counts():
    flat = np.minimum(np.arange(21) / 20.0, 0.8)
    assert never_flat(flat)[:17] == pytest.approx(flat[:17])
    assert np.diff(never_flat(flat))[16:] == pytest.approx([0.01] * 4)
    assert never_flat(np.arange(21) / 20.0) == pytest.approx(np.arange(21) / 20.0)


def test_no_plan_knows_of_a_step_in_its_tail():
    reference = np.array([25.0] * (HORIZON + 4) + [30.0] * 6)
    assert (_held_from_tail(reference) == 25.0).all()
    ramp = np.linspace(25.0, 30.0, HORIZON + 10)
    assert _held_from_tail(ramp) is ramp
    within = np.array([25.0] * 5 + [30.0] * (HORIZON + 5))
    assert _held_from_tail(within) is within


def test_no_plan_heats_against_the_fan_for_a_step_to_come(diagnosed):
    reference = np.array([27.0] * 6 + [31.0] * 6)
    free = problem(reference.tolist(), weight=0.03)
    low, high = band_before_steps(reference, 0.3, 99, 0.0)
    held = replace(free, low=low, high=high, band_weight=1e4, clash_weight=CLASH_WEIGHT)
    begun = PlanStart(at_rest(diagnosed, 27.0, ROOM_C), 0.0, ROOM_C, 5, 0)
    clash = []
    for goal in (free, held):
        plan = search(parts_of(diagnosed), goal, begun, 300).plan
        clash.append(float((plan.levels / HEATER_LEVELS * plan.fan)[:6].sum()))
    assert clash[0] > 0.3
    assert clash[1] < 0.2


def problem(
    reference, levels=HEATER_LEVELS, rules=None, weight=1.0, tail=0, temp_max=60.0
) -> PlanningProblem:
    nothing = np.zeros(len(reference))
    return PlanningProblem(
        nothing, nothing, nothing, np.array(reference), tail, weight, weight, levels,
        rules or FanRules(), temp_max, 1000.0,
    )  # fmt: skip


def start(twin: BoxTwin, temp: float = 24.0, fan: int = 0) -> PlanStart:
    return PlanStart(at_rest(twin, temp, ROOM_C), 0.0, ROOM_C, 0, fan)


def test_a_wide_beam_finds_the_best_of_all_plans():
    twin = BoxTwin(effects=WALL)
    step, goal = step_of(twin), problem([24.5, 26.0], levels=4)
    found = search(step, goal, start(twin), width=10_000)
    best = np.inf
    for options in itertools.product(itertools.product(range(5), (0, 1)), repeat=2):
        state, fan, cost = start(twin).state, 0, 0.0
        for k, (level, now) in enumerate(options):
            mode = 2 * fan + now
            state = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * ROOM_C
            state = state + step.now[mode] * level / HEATER_LEVELS
            cost += 10.0 * (state[0] - goal.reference[k]) ** 2 + (level / HEATER_LEVELS) ** 2 + now
            fan = now
        best = min(best, cost)
    assert found.plan.cost == pytest.approx(best, rel=1e-9)


def test_a_plan_heats_before_a_step_that_is_still_to_come(diagnosed):
    reference = [24.0] * 5 + [28.0] * 7
    found = search(step_of(diagnosed), problem(reference), start(diagnosed), width=300)
    held = search(step_of(diagnosed), problem([24.0] * 12), start(diagnosed), width=300)
    assert found.plan.levels[:5].sum() > 2 * held.plan.levels[:5].sum()
    assert found.runner_up is not None
    assert found.runner_up.cost >= found.plan.cost


def test_a_plan_keeps_the_relays_rules_and_the_heaters_limit(diagnosed):
    rules = FanRules(on=False, hold=2, min_on=3, min_off=2)
    goal = problem([22.0] * 8, levels=7, rules=rules)
    plan = search(step_of(diagnosed), goal, start(diagnosed, 30.0), width=50).plan
    assert goal.allows(plan.levels, plan.fan)
    assert plan.fan.any()


def test_no_plan_heats_the_air_beyond_its_limit(diagnosed):
    goal = problem([45.0] * 10, temp_max=30.0)
    assert search(step_of(diagnosed), goal, start(diagnosed), width=50).air.max() < 30.5


def test_the_same_question_gives_the_same_plan(diagnosed):
    plans = [
        search(step_of(diagnosed), problem([26.0] * 8), start(diagnosed), width=50).plan for _ in range(2)
    ]
    np.testing.assert_array_equal(plans[0].levels, plans[1].levels)
    np.testing.assert_array_equal(plans[0].fan, plans[1].fan)


@pytest.mark.parametrize("width", [3, 60, 10_000])
def test_the_beam_keeps_the_cheapest_of_each_kind_as_a_sort_of_all_would(width):
    """Equal costs, forbidden children and both states of the fan included."""
    rng, shape = np.random.default_rng(width), (50, 2, HEATER_LEVELS + 1)
    cost = rng.integers(0, 40, shape).astype(float)
    cost[rng.random(shape) < 0.3] = np.inf
    stored = KIND_K * rng.integers(-30, 30, shape)
    nothing = np.zeros((0,), dtype=np.int64)
    kept = _cheapest(_Children(cost, stored, np.zeros(0), nothing, nothing, nothing), width)

    kinds = {}
    for place in np.argsort(-cost, axis=None, kind="stable"):
        if np.isfinite(cost.ravel()[place]):
            fan = np.unravel_index(place, shape)[1]
            kinds[round(stored.ravel()[place] / KIND_K), fan] = place
    all_kinds = np.array([kinds[kind] for kind in sorted(kinds)])
    cheapest = all_kinds[np.argsort(cost.ravel()[all_kinds], kind="stable")[:width]]
    expected = all_kinds if len(all_kinds) <= width else cheapest
    assert kept.tolist() == expected.tolist()


PARTS = (0.0, 1.0 / 12.0, 0.25, 0.5, 1.0)


@pytest.mark.parametrize("share", PARTS)
@pytest.mark.parametrize("fan_before", [0, 1])
def test_a_part_of_a_step_is_the_twins_own_5_s_steps(diagnosed, share, fan_before):
    step = linear_step(diagnosed, at_rest(diagnosed, 25.0, ROOM_C), ROOM_C, {}, PARTS)
    rng = np.random.default_rng(2)
    state = at_rest(diagnosed, 27.0, ROOM_C) + rng.normal(size=len(diagnosed.states))
    fine = replace(diagnosed, step_s=5.0)
    fan = (np.arange(12) < round(12 * share)).astype(float)[None]
    march = fine.march(
        Commands(np.full((1, 12), 0.6), fan),
        np.full((1, 12), 22.0),
        before=Commands(np.full((1, 12), 0.2), np.full((1, 12), float(fan_before))),
    )
    expected = state[None]
    for part in range(12):
        expected = march.step(part, expected)
    mode = step.mode(fan_before, step.place_of(share))
    mine = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * 22.0
    mine += step.now[mode] * step.share_of(0.6) + step.late[mode] * step.share_of(0.2)
    np.testing.assert_allclose(mine, expected[0], atol=1e-8)


def parts_of(twin: BoxTwin):
    return linear_step(twin, at_rest(twin, 25.0, ROOM_C), ROOM_C, {}, PARTS)


def test_parts_follow_a_step_down_better_than_whole_steps(diagnosed):
    goal = problem([30.0] * 2 + [27.0] * 8, weight=0.03)
    costs = [search(step, goal, start(diagnosed, 30.0), 300).plan.cost for step in map_steps(diagnosed)]
    assert costs[1] < 0.8 * costs[0]


def map_steps(twin: BoxTwin):
    return step_of(twin), parts_of(twin)


def course(twin: BoxTwin, state, duty: float, fan_before: float, share: float):
    """The air after each 5 s of a step."""
    begun = (np.arange(12) < round(12 * share)).astype(float)[None]
    before = Commands(np.full((1, 12), duty), np.full((1, 12), float(fan_before)))
    march = replace(twin, step_s=5.0).march(
        Commands(np.full((1, 12), duty), begun), np.full((1, 12), ROOM_C), before=before
    )
    airs, states = [], state[None]
    for part in range(12):
        states = march.step(part, states)
        airs.append(states[0, 0])
    return np.array(airs)


def test_a_beam_with_parts_finds_the_best_of_all_plans():
    twin = BoxTwin(effects=WALL)
    step, goal = parts_of(twin), problem([23.0, 23.5], levels=2)
    found = search(step, goal, start(twin), width=10_000)
    best = np.inf
    for options in itertools.product(itertools.product(range(3), range(len(PARTS))), repeat=2):
        state, fan, cost = start(twin).state, 0, 0.0
        for k, (level, place) in enumerate(options):
            airs = course(twin, state, level / HEATER_LEVELS, fan, PARTS[place])
            mode = step.mode(fan, place)
            state = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * ROOM_C
            state = state + step.now[mode] * level / HEATER_LEVELS
            assert airs[-1] == pytest.approx(state[0])
            cost += 10.0 * np.mean((airs[2::3] - goal.reference[k]) ** 2)
            cost += (level / HEATER_LEVELS) ** 2 + PARTS[place]
            fan = int(PARTS[place] == 1.0)
        best = min(best, cost)
    assert found.plan.cost == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("left", [0, 1, 2])
def test_a_plan_starts_the_fan_no_more_often_than_it_may(diagnosed, left):
    goal = problem([24.0] * 10, weight=0.03)
    begin_ = replace(start(diagnosed, 32.0), fan_starts=left)
    plan = search(parts_of(diagnosed), goal, begin_, 200).plan
    before = np.append(0.0, plan.fan[:-1])
    assert ((plan.fan > 0.0) & (before < 1.0)).sum() <= left
    assert (plan.fan > 0.0).any() == (left > 0)


def test_a_held_relay_allows_no_part(diagnosed):
    goal = problem([24.0] * 6, rules=FanRules(on=True, hold=2), weight=0.03)
    plan = search(parts_of(diagnosed), goal, start(diagnosed, 32.0, fan=1), 100).plan
    assert plan.fan[:2].tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("step_s", "part_s", "parts_s"),
    [(60.0, 5.0, [5, 10, 15, 20, 30, 45]), (60.0, 15.0, [15, 20, 30, 45]), (10.0, 5.0, [5]), (5.0, 5.0, [])],
)
def test_the_parts_that_a_plan_may_use(step_s, part_s, parts_s):
    shares = fan_shares(step_s, ControlLimits(fan_part_s=part_s))
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert [share * step_s for share in shares[1:-1]] == pytest.approx(parts_s)


def test_before_a_step_the_air_has_bounds():
    reference = np.array([24.0, 24.0, *[28.0] * 12, 25.0, 25.0])
    low, high = band_before_steps(reference, 0.3, 99, 0.0)
    # ten steps after the one before, the air may still be on its way
    assert low.tolist() == pytest.approx([23.7, 23.7, *[-np.inf] * 11, 27.7, -np.inf, -np.inf])
    assert high.tolist() == pytest.approx([24.3, 24.3, *[np.inf] * 11, 28.3, np.inf, np.inf])


def test_air_that_is_outside_may_come_back_by_half_a_step():
    reference = np.array([*[24.0] * 4, 28.0])
    low, high = band_before_steps(reference, 0.3, 99, -2.0)
    assert low.tolist() == pytest.approx([23.0, 23.5, 23.7, 23.7, -np.inf])
    assert high.tolist() == pytest.approx([24.3] * 4 + [np.inf])


def test_a_step_that_was_just_taken_leaves_the_air_free():
    reference = np.array([*[24.0] * 5, 28.0])
    assert np.isinf(band_before_steps(reference, 0.3, 3, 0.0)[1]).all()
    assert band_before_steps(reference, 0.3, 8, 0.0)[1].tolist() == [np.inf] * 2 + [24.3] * 3 + [np.inf]


def test_a_ramp_and_a_constant_reference_have_no_bound():
    for reference in (np.linspace(24.0, 28.0, 20), np.full(20, 25.0)):
        low, high = band_before_steps(reference, 0.3, 99, 0.0)
        assert np.isinf(low).all() and np.isinf(high).all()


@pytest.mark.parametrize("goes", [4.0, -4.0])
def test_no_plan_is_early_for_a_step_by_more_than_it_may(diagnosed, goes):
    reference = np.array([27.0] * 6 + [27.0 + goes] * 6)
    free = problem(reference.tolist(), weight=0.03)
    low, high = band_before_steps(reference, 0.3, 99, 0.0)
    held = replace(free, low=low, high=high, band_weight=1e4)
    begun = PlanStart(at_rest(diagnosed, 27.0, ROOM_C), 0.0, ROOM_C, 5, 0)
    early = [
        float((np.sign(goes) * (search(parts_of(diagnosed), goal, begun, 300).air[:6] - 27.0)).max())
        for goal in (free, held)
    ]
    assert early[1] < 0.35
    assert goes < 0.0 or early[0] > 0.35


@pytest.mark.parametrize(
    ("fan", "duty", "steps"),
    [
        ([0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], 8),  # started three steps ago, strong heat since
        ([0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 0.45, 0.0], 0),
        ([0.0, 0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 0),  # the heat came before
        ([0.0, 1.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1.0], 8),  # one start, of three steps ago
        ([0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0], 0),
        ([0.0, 0.5, *[0.0] * 9], [1.0] * 11, 1),
        ([0.0, 0.5, *[0.0] * 10], [1.0] * 12, 0),
    ],
)
def test_the_fan_waits_ten_minutes_where_strong_heat_followed_its_last_start(fan, duty, steps):
    history = {"fan_on": np.array(fan), "heater_duty": np.array(duty)}
    assert wait_after_heat(history, 60.0) == steps
