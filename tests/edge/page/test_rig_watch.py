"""Alarms that the page notices in views of the rig, by a clock of the test's own."""

from typing import Any

import pytest
from page_process import view

from edge.page.alarms.rig_watch import AIR, BOARD, BOARD_TRIP, DAEMON, HOLD_S, STOP, TICKS, RigWatch, cause_of

SILENT_S = 120.0


def says(watch: RigWatch, seen: dict[str, Any], now_s: float) -> dict[str, bool | None]:
    return {finding.cause: finding.holds for finding in watch.look(seen, now_s)}


@pytest.fixture
def watch() -> RigWatch:
    return RigWatch(SILENT_S, 1000.0)


def test_a_rig_that_is_well_is_no_alarm(watch: RigWatch) -> None:
    assert set(says(watch, view(), 1001.0).values()) == {False}
    assert watch.is_alive(view(), 1001.0)


def test_a_silent_daemon_is_an_alarm_after_the_set_time_and_unknown_before(watch: RigWatch) -> None:
    assert says(watch, view(False, SILENT_S), 1001.0)[DAEMON] is None
    found = says(watch, view(False, SILENT_S + 1.0), 1002.0)
    assert found[DAEMON] is True
    # Its last answer is old news: nothing else is said by it.
    assert {cause: holds for cause, holds in found.items() if cause != DAEMON} == {TICKS: None, STOP: None}
    assert says(watch, view(), 1003.0)[DAEMON] is False


def test_a_daemon_that_never_answered_is_an_alarm_too(watch: RigWatch) -> None:
    assert says(watch, view(False, None), 1000.0 + SILENT_S)[DAEMON] is None
    assert says(watch, view(False, None), 1001.0 + SILENT_S)[DAEMON] is True


def test_ticks_that_do_not_advance_are_an_alarm_after_three_steps(watch: RigWatch) -> None:
    says(watch, view(), 1000.0)
    assert says(watch, view(), 1180.0)[TICKS] is False
    assert says(watch, view(), 1181.0)[TICKS] is True
    assert not watch.is_alive(view(), 1181.0)
    moved = view(tick={**view()["status"]["tick"], "seq": 6})
    assert says(watch, moved, 1182.0)[TICKS] is False
    assert watch.is_alive(moved, 1182.0)


def test_a_daemon_that_has_just_begun_has_time_for_its_first_tick(watch: RigWatch) -> None:
    begun = view(tick=None, since_start_s=5.0)
    assert says(watch, begun, 9000.0)[TICKS] is False
    assert not watch.is_alive(begun, 9000.0)
    assert says(watch, view(tick=None, since_start_s=SILENT_S + 1.0), 9200.0)[TICKS] is True


@pytest.mark.parametrize(
    ("cause", "status"),
    [
        (BOARD, {"link_up": 0}),
        (AIR, {"tick": {"seq": 5, "step_s": 60.0, "readings": {"temp_air_c": {"quality": "stale"}}}}),
        (AIR, {"tick": {"seq": 5, "step_s": 60.0, "readings": {}}}),
    ],
)
def test_a_moment_without_a_board_or_a_reading_is_no_alarm(watch: RigWatch, cause: str, status: Any) -> None:
    assert says(watch, view(**status), 1000.0)[cause] is None
    assert says(watch, view(**status), 1000.0 + HOLD_S - 0.1)[cause] is None
    assert says(watch, view(**status), 1000.0 + HOLD_S)[cause] is True
    assert says(watch, view(), 1011.0)[cause] is False
    assert says(watch, view(**status), 1012.0)[cause] is None


def test_a_board_that_is_not_the_pinned_one_is_not_a_silent_one(watch: RigWatch) -> None:
    foreign = view(link_up=0, foreign_board="board 2 answers, board 1 is pinned")
    assert [says(watch, foreign, at_s)[BOARD] for at_s in (1000.0, 1100.0)] == [False, False]


def test_a_pressed_stop_is_an_alarm_at_once_however_it_was_pressed(watch: RigWatch) -> None:
    assert says(watch, view(operation={"emergency_stop": True}), 1000.0)[STOP] is True
    by_board = view(echo={"tripped": 1, "trip_cause": "emergency_stop"})
    found = says(watch, by_board, 1001.0)
    assert (found[STOP], found[BOARD_TRIP]) == (True, False)
    waits = view(False, 3.0, waits={"by": "Ann\r\n (page)", "utc": None})
    (finding,) = [one for one in watch.look(waits, 1002.0) if one.cause == STOP]
    assert (finding.holds, finding.text.isprintable()) == (True, True)
    assert "Ann (page)" in finding.text


def test_trips_are_alarms_and_maintenance_is_not(watch: RigWatch) -> None:
    assert says(watch, view(echo={"tripped": 1, "trip_cause": "maintenance"}), 1000.0)[BOARD_TRIP] is False
    assert (
        says(watch, view(echo={"tripped": 1, "trip_cause": "over_temperature"}), 1001.0)[BOARD_TRIP] is True
    )
    assert says(watch, view(trips=["overheat"]), 1002.0)["safety.overheat"] is True
    assert BOARD_TRIP not in says(watch, view(echo=None), 1003.0)


def test_events_are_of_the_cause_that_the_page_sees() -> None:
    assert cause_of("board.unplugged", "x") == BOARD
    assert cause_of("board.tripped", "the board has tripped: emergency_stop") == STOP
    assert cause_of("board.tripped", "the board has tripped: over_temperature") == BOARD_TRIP
    assert cause_of("history.ticks_lost", "x") == "history.ticks_lost"
