"""A twin whose fan does what no fan does."""

import pytest

from edge.twin.effects.plausible import implausible, odd, with_usual_fan
from edge.twin.value import Value
from tests.support.designed import file_of

SHARE = ("effects", "fan_effectiveness", "eps_f")


def test_a_usual_fan_is_plausible():
    assert not list(implausible(file_of({"wall_loss": {"UA": 3.0}})))
    assert not list(implausible(file_of({"fan_effectiveness": {"eps_f": 1.2}, "fan_heat": {"P_fan": 5.0}})))


def test_a_fan_that_moves_twice_its_own_flow_is_not():
    (said,) = implausible(file_of({"fan_effectiveness": {"eps_f": 1.99}}))
    assert "changes 2.0 times the air" in said and "68 m3/h" in said


@pytest.mark.parametrize(
    ("share", "is_odd", "is_refused"),
    [(1.5, False, False), (1.51, True, False), (1.9, True, False), (1.91, False, True)],
)
def test_a_fan_that_moves_more_than_was_said_is_told_first_and_refused_far_beyond(share, is_odd, is_refused):
    file = file_of({"fan_effectiveness": {"eps_f": share}})
    assert (len(list(odd(file))), len(list(implausible(file)))) == (is_odd, is_refused)


def test_a_fan_that_heats_as_the_heater_does_is_not():
    (said,) = implausible(file_of({"fan_heat": {"P_fan": 60.0}}))
    assert "heats by 60 W, where the heater has 100 W" in said


def test_a_flow_that_was_fitted_freely_gets_a_usual_share():
    free = file_of({"fan_effectiveness": {"eps_f": 1.0}}).with_values({SHARE: Value(1.0, fit=True)})
    usual = with_usual_fan(free)
    assert usual is not None
    share = usual.values()[SHARE]
    assert not share.fit and share.value == 0.8 and share.rel_sd == 0.3
    assert with_usual_fan(usual) is None


@pytest.mark.parametrize("effects", [{}, {"fan_effectiveness": {"eps_f": 1.0}}])
def test_a_flow_that_is_not_fitted_stays_as_it_is(effects):
    assert with_usual_fan(file_of(effects)) is None
