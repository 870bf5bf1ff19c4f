import numpy as np

from edge.controllers.rules import Rules, Thresholds
from training.control.rig import TUNED
from training.control.tune import GRIDS, Grid, costs, tune


def test_what_is_in_use_stands_in_its_grid():
    for name, grid in GRIDS.items():
        assert all(value in values for value, values in zip(grid.shipped, grid.values, strict=True)), name


def test_the_tuned_thermostat_costs_a_fraction_of_the_fallbacks():
    reference = np.repeat([25.0, 29.0, 26.0], 40)
    fallback, thermostat = costs([Rules(), Rules(TUNED)], reference, 101)
    assert thermostat < fallback / 2


def test_the_cheapest_setting_comes_first(monkeypatch):
    monkeypatch.setattr("training.control.tune.CASES", (("tuning_1", 101),))
    grid = Grid(lambda on: Rules(Thresholds(heat_below_k=on)), ("on",), ((0.5, 3.0),), (0.5,))
    found = tune(grid)
    assert [setting for _, setting in found] == [(0.5,), (3.0,)]
    assert found[0][0] < found[1][0]
