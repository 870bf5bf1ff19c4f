"""bench/incubator.py: a quick box whose lid is opened as the set point rises."""

import pytest

from bench.incubator import LID_S, Lid, drive


@pytest.mark.slow
def test_pid_keeps_a_healthy_incubator_from_the_latch():
    """A step from 30 to 37 °C under an open lid. Before: 43.3 °C here, and the latch within a day."""
    row = drive("PID", minutes=100.0, seed=1)
    assert row.latches == ()
    assert row.hottest_c < 41.0


def test_the_lid_is_open_when_it_is_told():
    lid = Lid([100.0, 300.0], 25.0)
    times = (99.0, 100.0, 100.0 + LID_S, 300.0, 300.0 + LID_S, 1e6)
    assert [lid.conductance(time_s) for time_s in times] == [0.0, 25.0, 0.0, 25.0, 0.0, 0.0]
