"""Room, sun and mains: functions of time and seed within the stated swings."""

import numpy as np
import pytest

from bench.boxes.box import BoxDisturbances
from bench.boxes.draw import LOTS, draw_box

DAYS = 300.0 * np.arange(2 * 288)  # two days [s]


def test_the_future_is_the_same_whenever_it_is_asked_for() -> None:
    facts = draw_box(1)
    once, again = BoxDisturbances(facts, 5), BoxDisturbances(facts, 5)
    later = [once.at(t) for t in DAYS[::-1]][::-1]
    assert later == [again.at(t) for t in DAYS]
    other = BoxDisturbances(facts, 6)
    assert later != [other.at(t) for t in DAYS]


@pytest.mark.parametrize("seed", LOTS[0])
def test_a_room_swings_but_not_beyond_8_k(seed: int) -> None:
    facts = draw_box(seed)
    around = BoxDisturbances(facts, seed)
    room, sun, mains = np.array([around.at(t) for t in DAYS]).T
    assert 0.2 < np.ptp(room) <= 8.0
    assert room.min() > 8.0 and room.max() < 28.0
    assert (sun.max() > 0.0) == (facts.room.sun_peak_w_m2 > 0.0)
    assert sun.min() == 0.0  # the sun does not shine at night
    assert sun.max() <= 700.0
    assert np.abs(mains - 1.0).max() <= 0.03


def test_the_room_never_jumps() -> None:
    for seed in (1, 2, 106):
        around = BoxDisturbances(draw_box(seed), seed)
        room = np.array([around.room_c(float(t)) for t in range(0, 90_000, 10)])
        assert np.abs(np.diff(room)).max() < 0.1
