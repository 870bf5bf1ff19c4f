"""edge/lab/packaged.py: the project's rules and PID in a lab."""

import numpy as np
import pytest

from edge.core.errors import RequestError
from edge.lab import clock, lab
from edge.lab.packaged import PackagedController


@pytest.mark.parametrize("name", ["rules", "PID"])
def test_a_controller_brings_the_box_to_its_reference_and_back(name):
    controller, errors = PackagedController(name), []
    with lab() as box:
        for t in clock(3 * 3600, 60):
            reference = 28.0 if t < 7200 else 25.0
            command = controller(t, box.T1, box.T2, reference)
            box.Q1(100 * command.heater_duty)
            box.Q2(100 * command.fan)
            errors.append(box.T1 - reference)
    # Rules swing by up to 3 K: the heater's element is still hot when they turn it off.
    assert np.mean(np.abs(errors[60:120])) < 2.0
    assert np.mean(np.abs(errors[150:])) < 2.0


def test_an_unknown_air_is_not_heated():
    command = PackagedController("PID")(0.0, float("nan"), 21.0, 28.0)
    assert (command.heater_duty, command.fan_on) == (0.0, False)


def test_a_controller_that_needs_a_model_is_refused():
    with pytest.raises(RequestError, match="MPC: not a controller without a model; known: rules, PID"):
        PackagedController("MPC")
