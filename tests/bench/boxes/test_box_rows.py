"""The rows of the boxes' bench: what they come to, the PID that is tuned, the clairvoyant's step."""

import numpy as np
import pytest

from bench.boxes.__main__ import box_reference, summary, tuning_courses
from bench.boxes.box import Box
from bench.boxes.clairvoyant import _cost, simc, tangent, tune_pid
from bench.boxes.draw import draw_box
from edge.controllers.twin_plan.linear_step import linear_step
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

WALL = {"wall_loss": {"UA": 3.0}, "extra_capacity": {"kC": 5.0}, "heater_lag": {"tau_h": 120.0}}
ROOM_C = 21.0


def test_a_summary_compares_rows_of_one_rule():
    costs = [
        {"PID": 30.0, "MPC-Twin-P": 11.0, "clairvoyant": 10.0, "PID/early": 1.0, "MPC-Twin-P/early": 2.0},
        {"PID": 10.0, "MPC-Twin-P": 20.0, "clairvoyant": 15.0},
    ]
    lines = summary(costs)
    assert "MPC-Twin-P: by the limit 1.55 in the median, 2.00 in the worst" in lines[0]
    assert lines[0].endswith("ahead of every rival in 1 of 2")
    assert lines[1].endswith("2.00 in the worst; ahead of every rival in 0 of 1")


def test_the_tuned_pid_costs_less_than_the_rule_that_it_begins_with():
    twin, course = BoxTwin(effects=WALL), np.repeat([24.0, 30.0, 26.0], 60)
    rest = at_rest(twin, ROOM_C, ROOM_C)
    step = linear_step(twin, rest, ROOM_C, {})
    first, best = simc(twin, ROOM_C), tune_pid(twin, ROOM_C, [course], cools=True)
    both = np.array([first, (*best._gains, best._fan_on_k)])
    cost = _cost(step, both, rest, ROOM_C, course)
    assert cost[1] < 0.9 * cost[0]
    assert tune_pid(twin, ROOM_C, [course], cools=False)._fan_on_k > 1e3


@pytest.mark.parametrize("seed", [7, 510])
def test_the_clairvoyants_step_is_the_boxs_own_under_the_boards_pulses(seed):
    box = Box(draw_box(seed), seed)
    for time_s in range(300):
        box.step(1.0, _relay(time_s, 0.5), False, 0.0, False)
    fans = (0.0, 0.25, 1.0)
    step = tangent(box, 60.0, fans, 0.5)
    state = np.append(box.physics.reading_c(box.state), box.state[0])
    for place, fan in enumerate(fans):
        for duty in (0.4, 0.5, 0.6):
            told = step.matrix[place] @ state + step.constant[place] + step.now[place] * duty
            states = box.state
            for part in range(60):
                on, time_s = float(part < 60 * fan), box.time_s + part
                states = box.physics.step(states, time_s, 1.0, _relay(time_s, duty), on)
            near = 1e-6 if duty == 0.5 else 0.1
            assert told[0] == pytest.approx(float(box.physics.reading_c(states)[0]), abs=near)


def _relay(time_s: float, duty: float) -> float:
    return float(time_s % 20.0 < 20.0 * duty)


def test_the_tuning_of_the_pid_leaves_the_reference_that_it_is_driven_to(tmp_path):
    facts = draw_box(7)
    path = box_reference(facts, "reference_1", tmp_path)
    before = path.read_text()
    courses = tuning_courses(facts, tmp_path)
    assert len(courses) == 3
    assert path.read_text() == before
