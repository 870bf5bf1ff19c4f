"""edge/tick/faults.py: an event when a failure begins, one when it ends, none in between."""

import pytest

from edge.tick.faults import FAILURES, Conditions


def test_a_lasting_failure_is_told_twice() -> None:
    conditions = Conditions()
    for time_s, holds in ((0.0, False), (60.0, True), (120.0, True), (180.0, False), (240.0, False)):
        conditions.set("board.link_down", holds, time_s, 1e9 + time_s)
    begun, ended = conditions.take_events()
    assert (begun.key, begun.time_s) == ("board.link_down", 60.0)
    assert (ended.key, ended.time_s) == ("board.link_down.over", 180.0)
    assert "120 s" in ended.text
    assert conditions.take_events() == []


def test_the_event_says_what_happened_and_what_it_gets() -> None:
    conditions = Conditions()
    conditions.set("telemetry.offline", True, 0.0, 0.0, "connection refused")
    (event,) = conditions.take_events()
    failure = FAILURES["telemetry.offline"]
    assert event.text == f"{failure.what}: connection refused; {failure.answer}"
    assert event.severity is failure.severity


def test_a_failure_outside_the_table_is_a_bug() -> None:
    with pytest.raises(KeyError):
        Conditions().set("board.on_fire", True, 0.0, 0.0)
