"""The solver's proofs are true: against full enumeration, on problems of every kind."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.controllers.mixed_integer.polish import _fan_plans, descend, polish
from edge.controllers.mixed_integer.problem import FanRules, Plan, PlanningProblem, lower_toeplitz
from edge.controllers.mixed_integer.search import search, tangent, undominated_nodes
from edge.controllers.mixed_integer.solver import relaxed_temperatures, solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.core.errors import DataError

pytestmark = pytest.mark.slow


Ints = NDArray[np.int64]


def every_plan(levels: int, horizon: int) -> tuple[Ints, Ints]:
    """All heater levels and fan plans, [((levels + 1) * 2)^N, N] each."""
    steps = np.array(list(itertools.product(range(levels + 1), (0, 1))))
    index = np.indices((len(steps),) * horizon).reshape(horizon, -1).T
    chosen = steps[index]
    return chosen[..., 0], chosen[..., 1]


def true_optimum(problem: PlanningProblem) -> float:
    """Cost of the cheapest allowed plan, by looking at all of them."""
    levels, fan = every_plan(problem.heater_levels, problem.horizon)
    allowed = problem.allows(levels, fan)
    return float(problem.cost(levels[allowed], fan[allowed]).min())


@st.composite
def problems(
    draw: st.DrawFn, horizons: st.SearchStrategy[int], levels: st.SearchStrategy[int]
) -> PlanningProblem:
    """Problems of every kind: responses of any sign and shape, tails, relay rules, penalties."""
    n, tail = draw(horizons), draw(st.sampled_from((0, 0, 1, 7)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    decay = rng.uniform(-0.5, 1.05, size=2)[:, None] ** np.arange(n + tail)
    heater, fan = rng.normal(size=2)[:, None] * 5.0 * decay + rng.normal(scale=0.5, size=(2, n + tail))
    weights = (0.0, 1.0, 0.1)
    return PlanningProblem(
        free=rng.uniform(15.0, 30.0) + rng.normal(scale=draw(st.sampled_from((0.1, 3.0))), size=n + tail),
        heater=heater,
        fan=fan,
        reference=rng.uniform(18.0, 34.0) + draw(st.sampled_from((0.0, 2.0))) * rng.normal(size=n + tail),
        tail=tail,
        heater_weight=draw(st.sampled_from(weights)),
        fan_weight=draw(st.sampled_from(weights)),
        heater_levels=draw(levels),
        fan_rules=FanRules(
            on=draw(st.booleans()),
            hold=draw(st.integers(0, n)),
            min_on=draw(st.integers(1, 4)),
            min_off=draw(st.integers(1, 4)),
        ),
        temp_max=float(rng.uniform(22.0, 34.0)),
        limit_weight=draw(st.sampled_from((0.0, 0.0, 1000.0))),
    )


# against full enumeration


FOREVER = TimeBox(1e9)
MANY_NODES = 10**7
short = problems(st.integers(1, 2), st.just(20))
coarse = problems(st.integers(3, 5), st.integers(0, 3))


def close(cost: float) -> float:
    """Rounding errors of a cost."""
    return 1e-8 * (1.0 + abs(cost))


@settings(deadline=None, max_examples=60)
@given(short)
def test_short_plans_of_the_real_grid_are_the_cheapest_of_all(problem):
    solution = solve(problem, MANY_NODES, FOREVER)
    optimum = true_optimum(problem)
    assert solution.proven
    assert abs(solution.plan.cost - optimum) <= close(optimum)


@settings(deadline=None, max_examples=80)
@given(coarse)
def test_longer_plans_of_a_coarse_grid_are_the_cheapest_of_all(problem):
    solution = solve(problem, MANY_NODES, FOREVER)
    optimum = true_optimum(problem)
    assert solution.proven
    assert abs(solution.plan.cost - optimum) <= close(optimum)


@pytest.mark.parametrize("seed", range(2))
def test_three_steps_of_the_real_grid_are_the_cheapest_of_all(seed):
    rng = np.random.default_rng(seed)
    decay = 0.6 ** np.arange(3)
    problem = PlanningProblem(
        free=rng.uniform(20.0, 28.0, size=3),
        heater=5.0 * decay,
        fan=-2.8 * decay,
        reference=np.full(3, rng.uniform(22.0, 30.0)),
        heater_weight=float(seed % 2),
        fan_weight=float(seed % 2),
    )
    solution = solve(problem, MANY_NODES, FOREVER)
    assert solution.proven
    assert solution.plan.cost == pytest.approx(true_optimum(problem), rel=1e-9)


@settings(deadline=None, max_examples=80)
@given(coarse, st.integers(1, 60))
def test_a_small_budget_gives_an_allowed_plan_and_a_bound_below_the_optimum(problem, budget):
    solution = solve(problem, budget, FOREVER)
    optimum = true_optimum(problem)
    assert problem.allows(solution.plan.levels, solution.plan.fan)
    assert solution.bound <= optimum + close(optimum)
    assert solution.plan.cost >= optimum - close(optimum)
    assert solution.plan.cost == pytest.approx(float(problem.cost(solution.plan.levels, solution.plan.fan)))
    assert not solution.proven or solution.plan.cost <= optimum + close(optimum)


@settings(deadline=None, max_examples=60)
@given(coarse, st.integers(0, 30))
def test_a_solve_stopped_anywhere_keeps_an_honest_bound(problem, node_limit):
    nothing = np.zeros(problem.horizon, dtype=np.int64)
    warm = (nothing, nothing + int(problem.fan_rules.on))
    solution = solve(problem, MANY_NODES, FOREVER, node_limit=node_limit, warm=warm)
    optimum = true_optimum(problem)
    assert solution.bound <= optimum + close(optimum)
    assert not solution.proven or solution.plan.cost <= optimum + close(optimum)


@settings(deadline=None, max_examples=80)
@given(coarse, st.integers(0, 2**32 - 1))
def test_a_tangent_taken_anywhere_bounds_every_plan(problem, seed):
    rng = np.random.default_rng(seed)
    optimum = true_optimum(problem)
    rules = problem.fan_rules
    for temps in (
        relaxed_temperatures(problem),
        problem.reference + rng.normal(scale=5.0, size=len(problem.free)),
    ):
        bound = tangent(problem, temps)
        start = bound.constant[0, int(rules.on), rules.hold] + bound.slope @ problem.free
        assert start <= optimum + close(abs(start) + optimum)


@settings(deadline=None, max_examples=100)
@given(coarse, st.floats(1e-6, 30.0))
def test_a_search_that_drops_nothing_finds_the_optimum_below_any_known_cost(problem, above):
    optimum = true_optimum(problem)
    bounds = tangent(problem, relaxed_temperatures(problem))
    found = search(problem, bounds, 10**6, optimum + above + 10.0 * close(optimum))
    assert found.plan is not None
    assert abs(found.plan.cost - optimum) <= close(optimum)


@settings(deadline=None, max_examples=100)
@given(problems(st.integers(1, 3), st.integers(0, 2)), st.integers(0, 2**32 - 1))
def test_what_dominance_drops_is_never_needed(problem, seed):
    rng = np.random.default_rng(seed)
    rules, count = problem.fan_rules, 30
    spread = rng.choice([0.01, 0.1, 1.0])
    free = problem.free + rng.normal(scale=spread, size=(count, len(problem.free)))
    cost = rng.uniform(0.0, rng.choice([0.2, 2.0, 20.0]), size=count)
    fan, hold = rng.integers(0, 2, size=count), rng.integers(0, rules.holds, size=count)
    least = np.array([
        before + true_optimum(replace(problem, free=own, fan_rules=replace(rules, on=on, hold=steps)))
        for before, own, on, steps in zip(cost, free, fan.astype(bool).tolist(), hold.tolist(), strict=True)
    ])  # fmt: skip
    best = float(np.quantile(least, rng.uniform()))
    alive = undominated_nodes(problem, free, cost, fan, hold, best, 1e-9)
    dead_that_matter = least[~alive & (least < best)]
    assert dead_that_matter.size == 0 or least[alive].min() <= dead_that_matter.min() + 1e-9


@settings(deadline=None, max_examples=60)
@given(coarse)
def test_the_runner_up_has_another_first_step_and_costs_no_less(problem):
    solution = solve(problem, MANY_NODES, FOREVER)
    if solution.runner_up is None:
        levels, fan = every_plan(problem.heater_levels, problem.horizon)
        allowed = problem.allows(levels, fan)
        assert len(np.unique(np.stack([levels, fan])[:, allowed, 0], axis=1).T) == 1
        return
    first, other = solution.plan, solution.runner_up
    assert (first.levels[0], first.fan[0]) != (other.levels[0], other.fan[0])
    assert other.cost >= first.cost - close(first.cost)
    assert problem.allows(other.levels, other.fan)


@settings(deadline=None, max_examples=60)
@given(problems(st.integers(6, 12), st.integers(0, 20)), st.integers(0, 2**32 - 1))
def test_no_bound_is_above_any_plan_of_a_long_problem(problem, seed):
    solution = solve(problem, 2000, FOREVER)
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, problem.heater_levels + 1, size=(500, problem.horizon))
    fan = rng.integers(0, 2, size=(500, problem.horizon))
    allowed = problem.allows(levels, fan)
    near = problem.allows(np.clip(solution.plan.levels + rng.integers(-1, 2, size=levels.shape), 0,
                                  problem.heater_levels), solution.plan.fan[None, :])  # fmt: skip
    assert near.all()
    costs = problem.cost(levels[allowed], fan[allowed])
    assert solution.bound <= min([solution.plan.cost, *costs]) + close(solution.plan.cost)


@settings(deadline=None, max_examples=100)
@given(problems(st.integers(1, 8), st.integers(0, 20)))
def test_polish_keeps_the_rules_and_never_costs(problem):
    nothing = np.zeros(problem.horizon, dtype=np.int64)
    plan = Plan(nothing, nothing + int(problem.fan_rules.on), float("inf"))
    plan = replace(plan, cost=float(problem.cost(plan.levels, plan.fan)))
    better = polish(problem, plan)
    assert problem.allows(better.levels, better.fan)
    assert better.cost <= plan.cost
    assert better.cost == pytest.approx(float(problem.cost(better.levels, better.fan)))


def plain_problem(horizon: int = 20, **changes: object) -> PlanningProblem:
    """A box that must be cooled with a penalty on the fan: the search has to work for it."""
    decay = 0.75 ** np.arange(horizon)
    problem = PlanningProblem(
        free=24.3 - 0.01 * np.arange(horizon),
        heater=5.0 * decay,
        fan=-2.8 * decay,
        reference=np.full(horizon, 22.2),
        heater_weight=1.0,
        fan_weight=1.0,
    )
    return replace(problem, **changes)


def test_the_same_problem_gives_the_same_plan_bit_for_bit():
    one, two = (solve(plain_problem(), 3000, FOREVER) for _ in range(2))
    assert one.plan.levels.tolist() == two.plan.levels.tolist()
    assert (one.plan.cost, one.bound, one.nodes) == (two.plan.cost, two.bound, two.nodes)


def test_a_fired_time_box_is_replayed_by_its_node_count():
    fired = solve(plain_problem(), MANY_NODES, TimeBox(0.0))
    assert fired.time_box_fired
    replayed = solve(plain_problem(), MANY_NODES, FOREVER, node_limit=fired.nodes)
    assert replayed.time_box_fired
    assert replayed.plan.levels.tolist() == fired.plan.levels.tolist()
    assert (replayed.plan.cost, replayed.bound, replayed.nodes) == (fired.plan.cost, fired.bound, fired.nodes)


def test_a_budget_is_kept_and_enough_of_it_finds_the_cheapest():
    costs = []
    for budget in (1, 40, 400, 100_000):
        solution = solve(plain_problem(), budget, FOREVER)
        assert solution.nodes <= max(budget, 20)  # one node a step is the least there is
        costs.append(solution.plan.cost)
    assert solution.proven
    assert costs[-1] == min(costs) < costs[0] + close(costs[0])


def test_a_warm_start_is_used_only_where_it_is_allowed():
    problem = plain_problem(fan_rules=FanRules(on=False, hold=3))
    best = solve(problem, MANY_NODES, FOREVER).plan
    warm = solve(problem, 1, FOREVER, warm=(best.levels, best.fan))
    assert warm.plan.cost == pytest.approx(best.cost)
    forbidden = solve(problem, 1, FOREVER, warm=(best.levels, np.ones_like(best.fan)))
    assert problem.allows(forbidden.plan.levels, forbidden.plan.fan)


def test_a_capped_heater_stays_off_and_a_held_fan_stays_as_it_is():
    problem = plain_problem(heater_levels=0, fan_rules=FanRules(on=True, hold=20))
    solution = solve(problem, MANY_NODES, FOREVER)
    assert solution.plan.levels.tolist() == [0] * 20
    assert solution.plan.fan.tolist() == [1] * 20
    assert solution.runner_up is None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_problem_with_a_value_that_is_no_number_is_refused(bad):
    with pytest.raises(DataError, match="free"):
        plain_problem(3, free=np.array([20.0, bad, 20.0]))


def test_relay_rules_are_read_as_written():
    problem = plain_problem(6, fan_rules=FanRules(on=False, hold=1, min_on=3, min_off=2))
    heater = np.zeros(6, dtype=np.int64)
    expected = {
        (0, 1, 1, 1, 0, 0): True,
        (1, 1, 1, 1, 0, 0): False,  # switched while held
        (0, 1, 1, 0, 0, 0): False,  # on for two steps only
        (0, 1, 1, 1, 0, 1): False,  # off for one step only
        (0, 0, 0, 0, 0, 1): True,  # the rest of the on time lies beyond the horizon
    }
    assert {fan: bool(problem.allows(heater, np.array(fan))) for fan in expected} == expected


def test_a_level_outside_the_grid_is_not_allowed():
    problem = plain_problem(1)
    for level, fine in ((-1, False), (0, True), (20, True), (21, False)):
        assert bool(problem.allows(np.array([level]), np.array([0]))) is fine


def test_the_relaxation_is_near_its_optimum_where_that_is_known():
    problem = plain_problem(10, free=np.full(10, 20.0), reference=np.full(10, 40.0))  # full heat, fan off
    hottest = problem.temperatures(np.full(10, 20), np.zeros(10, dtype=np.int64))
    assert np.abs(relaxed_temperatures(problem) - hottest).max() < 1e-2


def test_a_node_is_dominated_only_by_a_cheaper_one_that_may_do_as_much():
    free = np.array([[20.0, 20.0], [20.0, 20.0], [20.0, 20.0]])
    cost = np.array([1.0, 2.0, 2.0])
    fan, hold = np.array([0, 0, 1]), np.array([1, 1, 1])
    ruled = plain_problem(3, fan_rules=FanRules(min_on=2, min_off=2))
    assert undominated_nodes(ruled, free, cost, fan, hold, 10.0, 1e-9).tolist() == [True, False, True]
    assert undominated_nodes(
        ruled, free[:2], cost[:2], fan[:2], np.array([1, 0]), 10.0, 1e-9
    ).all()  # less held
    freer = plain_problem(3)
    assert undominated_nodes(freer, free, cost, fan, hold, 10.0, 1e-9).tolist() == [True, False, False]
    assert undominated_nodes(freer, free, np.ones(3), fan, hold, 10.0, 1e-9).all()  # equals all stay


def test_a_cheaper_node_does_not_dominate_where_it_goes_over_the_limit():
    free = np.array([[30.05], [30.0]])
    cost = np.array([1.0, 2.0])  # 1000 * 0.05² = 2.5 is more than the difference
    limited = plain_problem(1, reference=np.array([30.0]), temp_max=30.0, limit_weight=1000.0)
    none = np.zeros(2, dtype=np.int64)
    assert undominated_nodes(limited, free, cost, none, none, 2.0, 1e-9).all()
    free_of_it = replace(limited, limit_weight=0.0)
    assert undominated_nodes(free_of_it, free, cost, none, none, 2.0, 1e-9).tolist() == [True, False]


def slow_heater_problem() -> PlanningProblem:
    """A box that is 1.5 K too warm: its fan takes 2.3 K at once, its heater acts a step later, for long."""
    tail, lag = 10, np.arange(20)
    return PlanningProblem(
        free=26.0 + 1.5 * 0.97**lag,
        heater=np.where(lag == 0, 0.03, 0.9 * 0.95**lag),
        fan=-2.3 * 0.8**lag,
        reference=np.full(20, 26.0),
        tail=tail,
    )


def test_polish_redoes_a_slow_heater_with_all_the_horizon_in_view():
    problem = slow_heater_problem()
    fan = np.array([1] + [0] * 9)
    swinging = np.array([20, 0] * 5)  # what the next temperature alone asks for
    better = polish(problem, Plan(swinging, fan, float(problem.cost(swinging, fan))))
    best = solve(problem, MANY_NODES, TimeBox(20.0)).plan.cost
    assert better.cost <= 1.01 * best


def test_descent_stops_where_no_move_it_knows_is_better():
    problem = slow_heater_problem()
    response = lower_toeplitz(problem.heater, 10).T
    rng = np.random.default_rng(1)
    levels, fan = rng.integers(0, 21, size=(30, 10)), rng.integers(0, 2, size=(30, 10))
    found, temps = descend(problem, response, levels, problem.temperatures(levels, fan), 1000)
    cost = problem.cost(found, fan)
    assert np.abs(temps - problem.temperatures(found, fan)).max() < 1e-9
    assert (cost <= problem.cost(levels, fan)).all()
    for k in range(10):
        for step in (-1, 1):
            moved = found.copy()
            moved[:, k] = np.clip(moved[:, k] + step, 0, 20)
            assert (problem.cost(moved, fan) >= cost - 1e-9).all()


@settings(deadline=None, max_examples=60)
@given(coarse, st.integers(0, 2**32 - 1))
def test_descent_keeps_the_heaters_bounds(problem, seed):
    rng = np.random.default_rng(seed)
    shape = (8, problem.horizon)
    levels, fan = rng.integers(0, problem.heater_levels + 1, size=shape), rng.integers(0, 2, size=shape)
    response = lower_toeplitz(problem.heater, problem.horizon).T
    found, temps = descend(problem, response, levels, problem.temperatures(levels, fan), 3)
    assert found.min() >= 0
    assert found.max() <= problem.heater_levels
    assert np.abs(temps - problem.temperatures(found, fan)).max() < 1e-6 * (1.0 + np.abs(temps).max())


def test_polish_switches_a_fan_that_runs_for_nothing():
    problem = plain_problem(reference=np.full(20, 24.0))
    running = np.ones(20, dtype=np.int64)
    plan = Plan(running * 0, running, float(problem.cost(running * 0, running)))
    assert polish(problem, plan).cost < 0.1 * plan.cost


def test_a_search_that_can_find_nothing_better_says_so():
    problem = plain_problem(4)
    best = solve(problem, MANY_NODES, FOREVER).plan.cost
    found = search(problem, tangent(problem, relaxed_temperatures(problem)), 1000, best)
    assert found.plan is None
    assert found.bound == np.inf


def test_a_search_on_a_busy_machine_gets_its_cpu_time():
    """Wall time that other processes take does not shorten the search."""
    quiet, busy = (
        solve(plain_problem(), MANY_NODES, TimeBox(1.0, cpu=ticking(0.01), wall=ticking(wall_s)))
        for wall_s in (0.01, 0.025)
    )
    assert (busy.nodes, busy.plan.cost) == (quiet.nodes, quiet.plan.cost)


def test_a_search_that_gets_no_cpu_time_ends_by_the_wall_clock():
    starved = solve(plain_problem(), MANY_NODES, TimeBox(1.0, cpu=lambda: 0.0, wall=ticking(1.0)))
    assert starved.time_box_fired
    box = TimeBox(1.0, wall_s=2.0, cpu=lambda: 0.0, wall=iter((10.0, 11.9, 12.1)).__next__)
    assert [box.is_over(), box.is_over()] == [False, True]


def ticking(step_s):
    """A clock that goes on by `step_s` at each look."""
    return itertools.count(0.0, step_s).__next__


@given(st.lists(st.integers(0, 1), min_size=1, max_size=6))
def test_the_polish_tries_one_or_two_switches_and_a_rest_on_or_off(fan):
    plans = {tuple(plan) for plan in _fan_plans(np.array(fan)).tolist()}
    near = {plan for plan in itertools.product((0, 1), repeat=len(fan)) if _distance(plan, fan) <= 2}
    rests = {(*fan[:k], *[state] * (len(fan) - k)) for k in range(len(fan)) for state in (0, 1)}
    assert plans == near | rests


def _distance(one, other):
    return sum(a != b for a, b in zip(one, other, strict=True))
