"""The MPC benchmark's problems: the same for every horizon, and solvable."""

import numpy as np

from bench.two_node_box import fitted_model, instances
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox


def test_the_same_instances_come_at_every_horizon():
    model = fitted_model(1).model
    short, long = (list(instances(model, 2, horizon, 1.0, seed=1)) for horizon in (3, 6))
    for one, other in zip(short, long, strict=True):
        np.testing.assert_allclose(one.free, other.free[:3])
        assert solve(one, 10_000, TimeBox(1e9)).proven


def test_both_ways_of_the_fan_can_be_fitted_to_the_box():
    assert fitted_model(1, "on").model.fan_input == "on"
    assert fitted_model(1, "excess").model.fan_input == "excess"
