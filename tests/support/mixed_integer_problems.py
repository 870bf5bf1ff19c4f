"""Random planning problems and their true optimum by full enumeration."""

import itertools

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import FanRules, PlanningProblem

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
