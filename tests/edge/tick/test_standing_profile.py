"""edge/tick/standing_profile.py: a profile's own time, and what the loop makes of it."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from loop_rig import LoopRig

from edge.core.errors import DataError, RequestError
from edge.formats.reader import read
from edge.safety.supervisor import SafetyMemory
from edge.tick.loop import Loop
from edge.tick.order_words import order_words
from edge.tick.orders import Desk, Operation, operate
from edge.tick.orders_json import from_dict, to_dict
from edge.tick.standing_profile import POINTS_MAX, SAVE_EVERY_S, StandingProfile, duration

HOUR = 3600.0
DAY = StandingProfile("bread", (0.0, 2 * HOUR, 6 * HOUR), (24.0, 30.0, 20.0))
START: dict[str, Any] = {
    "do": "start_profile",
    "profile": {"name": "bread", "times_s": [0.0, 2 * HOUR, 6 * HOUR], "targets_c": [24.0, 30.0, 20.0]},
}


@pytest.fixture
def rig() -> Iterator[LoopRig]:
    rig = LoopRig()
    yield rig
    rig.close()


def ahead(profile: StandingProfile, since_start_s: float, hours: int) -> list[float]:
    reference = profile.reference(since_start_s)
    return reference.ahead(since_start_s, 0.0, HOUR, hours).tolist()


def test_a_target_holds_until_the_next_one_and_the_last_for_ever() -> None:
    assert ahead(DAY, 5e5, 8) == [24.0, 24.0, 30.0, 30.0, 30.0, 30.0, 20.0, 20.0]
    assert ahead(DAY.later(5 * HOUR), 5e5, 3) == [30.0, 20.0, 20.0]


def test_lines_lead_from_point_to_point() -> None:
    assert ahead(replace(DAY, is_linear=True), 0.0, 7) == [24.0, 27.0, 30.0, 27.5, 25.0, 22.5, 20.0]


def test_paused_its_present_target_holds_and_its_time_stands() -> None:
    paused = replace(DAY.later(HOUR), is_paused=True, is_linear=True)
    assert paused.later(HOUR) == paused
    assert ahead(paused, 1e4, 4) == [27.0] * 4


def test_its_time_ends_with_its_last_point_and_never_runs_back() -> None:
    assert DAY.later(100 * HOUR).position_s == 6 * HOUR
    assert DAY.later(100 * HOUR).is_over
    assert DAY.later(-HOUR) == DAY


def test_it_is_worth_a_write_every_ten_minutes_and_at_its_end() -> None:
    steps = [DAY]
    while not steps[-1].is_over:
        steps.append(steps[-1].later(60.0))
    writes = [after for before, after in pairwise(steps) if after.is_due(before)]
    assert len(writes) == 6 * HOUR / SAVE_EVERY_S
    assert writes[-1].is_over


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"times_s": [0.0, 10.0, 10.0]}, "times_s: has to rise"),
        ({"times_s": [1.0, 10.0, 20.0]}, "times_s: the first one has to be 0"),
        ({"times_s": [0.0, 10.0]}, "targets_c: 3 targets for 2 times"),
        ({"times_s": [], "targets_c": []}, "times_s"),
        ({"targets_c": [24.0, float("nan"), 20.0]}, "targets_c"),
        ({"targets_c": [24.0, "warm", 20.0]}, "targets_c"),
        ({"targets_c": [24.0, 39.0, 20.0]}, r"profile.targets_c\[1\]: 39"),
        ({"targets_c": [24.0, 14.0, 20.0]}, r"profile.targets_c\[1\]: 14"),
        ({"name": ""}, "name"),
        ({"name": "x" * 41}, "name"),
        ({"position_s": -1.0}, "position_s"),
        ({"colour": "red"}, "colour"),
        ({"times_s": list(range(POINTS_MAX + 1)), "targets_c": [24.0] * (POINTS_MAX + 1)}, "times_s"),
    ],
)
def test_a_profile_that_cannot_be_is_refused_with_its_place(values: dict[str, Any], why: str) -> None:
    desk = Desk(0.0, ("MPC",), 15.0, 38.0)
    with pytest.raises(RequestError, match=why):
        operate(Operation("MPC"), {**START, "profile": START["profile"] | values}, desk)


def test_it_takes_the_place_of_a_temperature_by_hand_and_ends_where_it_is_ended() -> None:
    desk = Desk(0.0, ("MPC",), 15.0, 38.0)
    by_hand = Operation("MPC", reference_c=27.0)
    started = operate(by_hand, START, desk)
    assert (started.reference_c, started.profile) == (None, DAY)
    later = operate(started, {"do": "skip_profile"}, desk)
    assert later.profile is not None and later.profile.position_s == 2 * HOUR
    assert operate(later, {"do": "end_profile"}, desk) == Operation("MPC")
    for order in ("pause_profile", "resume_profile", "skip_profile", "end_profile"):
        after = operate(by_hand, {"do": order}, desk)
        said = order_words(order, by_hand, after, 0.0)
        assert (after, said) == (by_hand, (False, "Nothing changed: no profile is followed."))
    over = replace(started, profile=DAY.later(9 * HOUR))
    with pytest.raises(RequestError, match="the profile is over"):
        operate(over, {"do": "skip_profile"}, desk)


def test_it_is_in_the_state_file_only_where_it_is_followed() -> None:
    """Earlier software, which an upgrade may go back to, refuses a key that it does not know."""
    assert "profile" not in to_dict(Operation("MPC"))
    followed = Operation("MPC", profile=replace(DAY, position_s=700.0, is_paused=True, is_linear=True))
    assert from_dict(to_dict(followed)) == followed
    assert to_dict(followed)["profile"]["paused"] is True


def test_a_damaged_one_in_the_state_file_is_refused() -> None:
    values = to_dict(Operation("MPC", profile=DAY))
    values["profile"]["position_s"] = "soon"
    with pytest.raises(DataError, match=r"profile\.position_s"):
        from_dict(values)
    with pytest.raises(DataError, match="position_s"):
        read(StandingProfile, {**START["profile"], "position_s": 1e300})


def reference_of(rig: LoopRig) -> float:
    return rig.tick().reference_c


def test_the_loop_follows_it_and_says_when_it_is_over(rig: LoopRig) -> None:
    rig.tick()
    rig.ask(START)
    targets, over = [], []
    for _ in range(7 * 60):
        record = rig.tick()
        targets.append(record.reference_c)
        over += [event.text for event in record.events if event.key == "profile.over"]
    assert np.unique(targets).tolist() == [20.0, 24.0, 30.0]
    assert abs(targets.count(24.0) - 120) <= 1 and abs(targets.count(30.0) - 240) <= 1
    assert over == ["the profile bread is over; its last target, 20 °C, holds"]


def test_its_time_stands_still_while_a_person_holds_everything_off(rig: LoopRig) -> None:
    rig.tick()
    rig.ask(START)
    for order, end in (
        ({"do": "emergency_stop"}, {"do": "release_emergency_stop"}),
        ({"do": "maintenance", "minutes": 60}, {"do": "maintenance", "minutes": 0}),
        ({"do": "pause_profile"}, {"do": "resume_profile"}),
    ):
        rig.ask(order)
        before = rig.loop.status().operation.profile
        for _ in range(30):
            rig.tick()
        after = rig.loop.status().operation.profile
        assert before is not None and after is not None
        assert after.position_s == before.position_s
        rig.ask(end)
        rig.tick()
        assert rig.loop.status().operation.profile.position_s > after.position_s


def test_after_a_power_cut_it_goes_on_where_it_was_whatever_the_clock_says(rig: LoopRig) -> None:
    rig.tick()
    rig.ask(START)
    for _ in range(125):
        rig.tick()
    reached = rig.loop.status().operation.profile
    kept = from_dict(to_dict(rig.saved[-1]))
    assert reached is not None and kept.profile is not None
    assert 0.0 <= reached.position_s - kept.profile.position_s < SAVE_EVERY_S
    rig.clock.utc_offset -= 1e8  # a computer without a clock of its own starts in the past
    rig.loop.close()
    rig.loop = Loop(rig.rig, kept, SafetyMemory(), first_seq=500)
    assert reference_of(rig) == 30.0
    rig.clock.utc_offset += 1e8  # the network tells it the time
    rig.tick()
    rig.tick()
    profile = rig.loop.status().operation.profile
    assert profile is not None
    assert profile.position_s - kept.profile.position_s < 4 * 60.0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.0, "0 min"), (3540.0, "59 min"), (12_000.0, "3 h 20 min"), (183_600.0, "2 d 3 h")],
)
def test_a_length_of_time_in_words(seconds: float, words: str) -> None:
    assert duration(seconds) == words
