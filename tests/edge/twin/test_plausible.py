"""A twin whose fan does what no fan does."""

from edge.twin.effects.plausible import implausible
from tests.support.designed import file_of


def test_a_usual_fan_is_plausible():
    assert not list(implausible(file_of({"wall_loss": {"UA": 3.0}})))
    assert not list(implausible(file_of({"fan_effectiveness": {"eps_f": 1.2}, "fan_heat": {"P_fan": 5.0}})))


def test_a_fan_that_moves_twice_its_own_flow_is_not():
    (said,) = implausible(file_of({"fan_effectiveness": {"eps_f": 1.99}}))
    assert "changes 2.0 times the air" in said and "68 m3/h" in said


def test_a_fan_that_heats_as_the_heater_does_is_not():
    (said,) = implausible(file_of({"fan_heat": {"P_fan": 60.0}}))
    assert "heats by 60 W, where the heater has 100 W" in said
