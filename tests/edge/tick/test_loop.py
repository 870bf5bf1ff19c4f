"""edge/tick/loop.py: the order of a tick, and what each row of the failure table gets."""

import json
import math
import queue
import select
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from loop_rig import UTC_0, LoopRig, is_safe

from edge.commands.orders import status_lines
from edge.core.messages import AirSensorPair, Command, ReadingQuality, Severity, TickRecord
from edge.mqtt.states import state
from edge.safety.box_bounds import paper_box
from edge.safety.supervisor import SafetyMemory
from edge.state.store import STANDING, restore
from edge.tick.faults import FAILURES, Conditions
from edge.tick.inbox import ORDINARY, Letter
from edge.tick.loop import RELEASE_EVERY_S, RELEASES, Loop
from edge.tick.orders import Operation
from edge.tick.status import status_json


@pytest.fixture
def rig() -> Iterator[LoopRig]:
    rig = LoopRig()
    yield rig
    rig.close()


def begins(record: TickRecord, key: str) -> bool:
    """Return whether this tick reports that `key` of the failure table begins."""
    return key in {event.key for event in record.events}


def ends(record: TickRecord, key: str) -> bool:
    return f"{key}.over" in {event.key for event in record.events}


def test_a_good_tick_sends_what_the_controller_wants(rig: LoopRig) -> None:
    record = rig.tick()
    assert record.decision.controller == "MPC"
    assert record.sent == record.wanted == Command(heater_duty=0.5)
    assert record.echo is not None
    assert record.echo.heater_duty == 0.5
    assert rig.board.driven[-1][2] == 60.0  # one step
    assert rig.sink.records == [record]


def test_sequence_numbers_have_no_holes(rig: LoopRig) -> None:
    assert [rig.tick().seq for _ in range(5)] == [1, 2, 3, 4, 5]


def test_the_first_controller_is_reset_once_and_again_when_it_comes_back(rig: LoopRig) -> None:
    rig.tick()
    rig.tick()
    assert rig.chosen.resets == 1
    rig.ask({"do": "set_controller", "name": "rules"})
    rig.tick()
    rig.ask({"do": "set_controller", "name": "MPC"})
    rig.tick()
    assert (rig.chosen.resets, rig.fallback.resets) == (2, 1)


# the failure table, row by row


def test_of_two_air_sensors_that_disagree_the_model_names_the_likely_one(rig: LoopRig) -> None:
    for _ in range(3):
        rig.board.air_pair = AirSensorPair(22.0, 22.2, are_apart=False)
        assert not begins(rig.tick(), "air_sensors.apart")
    rig.board.temp_air, rig.board.air_pair = 26.0, AirSensorPair(22.1, 26.0, are_apart=True)
    record = rig.tick()
    assert begins(record, "air_sensors.apart")
    [event] = [event for event in record.events if event.key == "air_sensors.apart"]
    assert "22.1 and 26.0 °C; the model expected 2" in event.text
    assert "the first one is likely right" in event.text
    rig.board.air_pair = AirSensorPair(22.1, None, are_apart=False)
    record = rig.tick()
    assert ends(record, "air_sensors.apart") and begins(record, "air_sensors.alone")


@pytest.mark.parametrize(
    ("value", "quality"),
    [
        (None, ReadingQuality.FAULT),
        (math.nan, ReadingQuality.GOOD),
        (22.0, ReadingQuality.STALE),
        (200.0, ReadingQuality.GOOD),
        (None, ReadingQuality.ABSENT),
    ],
)
def test_a_reading_that_is_not_good_turns_the_heater_off(
    rig: LoopRig, value: float | None, quality: ReadingQuality
) -> None:
    rig.tick()
    rig.board.temp_air, rig.board.quality = value, quality
    record = rig.tick()
    assert begins(record, "reading.not_good")
    assert record.sent.heater_duty == 0.0
    assert record.decision.controller == "MPC"  # still asked: the estimate goes on by model
    assert math.isfinite(record.estimate.temp_air)
    rig.board.temp_air, rig.board.quality = 22.0, ReadingQuality.GOOD
    assert ends(rig.tick(), "reading.not_good")
    assert rig.tick().sent.heater_duty == 0.5


def test_an_estimate_too_old_asks_no_controller(rig: LoopRig) -> None:
    rig.tick()
    rig.board.quality = ReadingQuality.FAULT
    records = [rig.tick() for _ in range(16)]  # 15 minutes are allowed
    asked = rig.chosen.asked
    last = rig.tick()
    assert begins(records[-1], "estimate.old") or begins(last, "estimate.old")
    assert last.decision.controller == "none"
    assert is_safe(last.sent)
    assert rig.chosen.asked == asked
    assert last.decision.why["failure"] == "estimate.old"


def test_before_any_reading_the_rig_is_safe(rig: LoopRig) -> None:
    rig.board.quality = ReadingQuality.FAULT
    record = rig.tick()
    assert is_safe(record.sent)
    assert rig.chosen.asked == 0


def test_a_controller_that_raises_leaves_the_step_to_the_fallback(rig: LoopRig) -> None:
    rig.chosen.error = RuntimeError("matrix is singular")
    record = rig.tick()
    assert begins(record, "controller.raised")
    assert record.decision.controller == "rules"
    assert record.decision.why["instead_of"] == "MPC"
    assert record.sent.heater_duty == pytest.approx(0.1)
    assert any("matrix is singular" in event.text for event in record.events)
    rig.chosen.error = None
    back = rig.tick()
    assert ends(back, "controller.raised")
    assert back.decision.controller == "MPC"


def test_a_controller_that_is_no_more_leaves_the_step_to_the_fallback(rig: LoopRig) -> None:
    rig.tick()
    del rig.rig.controllers["MPC"]
    record = rig.tick()
    assert begins(record, "controller.raised")
    assert record.decision.controller == "rules"
    assert "MPC: this rig has no such controller now" in [event.text for event in record.events]


@pytest.mark.parametrize("duty", [math.nan, math.inf, -math.inf])
def test_a_controller_without_a_number_leaves_the_step_to_the_fallback(rig: LoopRig, duty: float) -> None:
    rig.chosen.command = Command(heater_duty=duty)
    record = rig.tick()
    assert begins(record, "controller.not_a_number")
    assert record.decision.controller == "rules"


def test_a_controller_that_is_late_leaves_the_step_to_the_fallback(rig: LoopRig) -> None:
    rig.chosen.hang_s = 0.5
    record = rig.tick()
    assert begins(record, "controller.late")
    assert record.decision.controller == "rules"


def test_when_the_fallback_fails_too_nothing_is_on(rig: LoopRig) -> None:
    rig.chosen.error = rig.fallback.error = RuntimeError("broken")
    record = rig.tick()
    assert begins(record, "fallback.failed")
    assert is_safe(record.sent)
    assert record.decision.controller == "none"


def test_without_a_link_the_heater_counts_as_off(rig: LoopRig) -> None:
    rig.tick()
    rig.board.link_up, rig.board.echo = False, None
    record = rig.tick()
    assert begins(record, "board.link_down")
    assert record.echo is None
    assert record.sent.heater_duty == 0.0
    assert rig.rig.estimator.history()["heater_duty"][-1] == 0.0
    standing = status_json(rig.loop.status())["conditions"]
    assert standing["board.link_down"] == "no word from the board"
    rig.board.link_up = True
    assert ends(rig.tick(), "board.link_down")
    assert "board.link_down" not in status_json(rig.loop.status())["conditions"]


def test_a_command_that_is_not_confirmed_counts_as_not_driven(rig: LoopRig) -> None:
    rig.board.confirms = False
    record = rig.tick()
    assert begins(record, "board.no_echo")
    assert record.echo is None
    assert rig.rig.estimator.history()["heater_duty"][-1] == 0.0


def test_a_late_tick_is_told(rig: LoopRig) -> None:
    record = rig.loop.tick(rig.clock.now(), late_s=7.0)
    assert begins(record, "tick.late")
    assert record.late_s == 7.0


def test_a_jump_of_the_wall_clock_is_told_and_changes_no_command(rig: LoopRig) -> None:
    before = rig.tick()
    rig.clock.utc_offset += 3600.0
    record = rig.tick()
    assert begins(record, "clock.jumped")
    assert record.sent == before.sent
    assert ends(rig.tick(), "clock.jumped")


@pytest.mark.parametrize(
    "key",
    [
        "history.behind",
        "history.replaced",
        "telemetry.offline",
        "state.unwritten",
        "bundle.refused",
        "output.behind",
        "telemetry.flooded",
        "telemetry.name_taken",
    ],
)
def test_what_ails_a_sink_is_told_and_control_goes_on(rig: LoopRig, key: str) -> None:
    before = rig.tick()
    rig.sink.ill = {key: "no space left on device"}
    record = rig.tick()
    assert begins(record, key)
    assert any("no space left" in event.text for event in record.events)
    assert record.sent == before.sent
    rig.sink.ill = {}
    assert ends(rig.tick(), key)


def test_a_broken_state_file_is_an_emergency_stop(rig: LoopRig, tmp_path: Any) -> None:
    path = tmp_path / "state.json"
    path.write_text('{"operation": {"mode": "auto"')
    standing = restore(STANDING, replace(rig.settings, state_file=str(path)))
    assert standing.operation.emergency_stop
    rig.loop.note("state.broken", standing.broken)
    assert begins(rig.tick(), "state.broken")


def test_every_row_of_the_failure_table_is_tested() -> None:
    source = Path(__file__).read_text()
    assert [key for key in FAILURES if f'"{key}"' not in source] == []


# when to tick


def run_until(rig: LoopRig, ticks: int, each: Any = lambda record: None) -> list[TickRecord]:
    def after(record: TickRecord) -> None:
        each(record)
        if len(rig.sink.records) >= ticks:
            rig.loop.stop()

    object.__setattr__(rig.rig, "after_tick", after)
    rig.loop.run()
    return rig.sink.records


def test_ticks_keep_to_their_grid_however_long_they_take(rig: LoopRig) -> None:
    def slow(record: TickRecord) -> None:
        rig.clock.now_s += 3.7

    records = run_until(rig, 10, slow)
    starts = [record.time_s for record in records]
    assert [b - a for a, b in pairwise(starts)] == [60.0] * 9
    assert all(record.ticks_skipped == 0 for record in records)


def test_ticks_that_were_missed_are_counted_and_not_made_up(rig: LoopRig) -> None:
    def suspended_once(record: TickRecord) -> None:
        if record.seq == 2:
            rig.clock.now_s += 200.0  # grid points at +60, +120 and +180 s go by

    records = run_until(rig, 4, suspended_once)
    assert [record.ticks_skipped for record in records] == [0, 0, 3, 0]
    assert records[2].time_s - records[1].time_s == 240.0


def test_the_end_of_the_loop_turns_everything_off(rig: LoopRig) -> None:
    run_until(rig, 2)
    command, _, _ = rig.board.driven[-1]
    assert command == Command()


def test_an_error_of_our_own_ends_with_the_heater_off(rig: LoopRig) -> None:
    def explode(record: TickRecord) -> None:
        raise AssertionError("a bug")

    object.__setattr__(rig.rig, "after_tick", explode)
    with pytest.raises(AssertionError, match="a bug"):
        rig.loop.run()
    assert rig.board.driven[-1][0] == Command()


# requests


def test_an_emergency_stop_acts_at_once_and_stays(rig: LoopRig) -> None:
    rig.tick()
    reply = rig.ask({"do": "emergency_stop"})
    assert reply["ok"]
    assert rig.board.stops == 1
    assert is_safe(rig.board.driven[-1][0])
    assert rig.saved[-1].emergency_stop
    assert is_safe(rig.tick().sent)
    assert rig.tick().mode == "emergency_stop"
    rig.ask({"do": "release_emergency_stop"})
    assert not rig.board.stopped and rig.board.cleared == 0
    assert rig.tick().sent.heater_duty == 0.5


def test_an_order_takes_effect_before_the_next_tick(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "set_mode", "mode": "off"})
    assert rig.board.driven[-1][0].heater_duty == 0.0
    assert "operator.order" in {event.key for event in rig.tick().events}


def test_an_order_in_the_middle_of_a_step_looks_at_fresh_readings(rig: LoopRig) -> None:
    rig.tick()
    rig.clock.now_s += 30.0  # the tick's own readings are too old to heat on by now
    rig.ask({"do": "set_mode", "mode": "heat"})
    assert rig.board.driven[-1][0].heater_duty == 0.5
    events = rig.tick(30.0).events
    assert any(event.key == "operator.sent" and "heater 0.50" in event.text for event in events)


@pytest.mark.parametrize(
    "request_", [{"do": "set_reference", "reference_c": 26}, {"do": "set_controller", "name": "rules"}]
)
def test_a_new_reference_or_controller_waits_for_the_next_decision(
    rig: LoopRig, request_: dict[str, Any]
) -> None:
    rig.tick()
    sent = len(rig.board.driven)
    assert rig.ask(request_)["ok"]
    assert len(rig.board.driven) == sent


def test_a_refused_request_says_why_and_changes_nothing(rig: LoopRig) -> None:
    rig.tick()
    commands = len(rig.board.driven)
    reply = rig.ask({"do": "set_reference", "reference_c": 200})
    assert reply["ok"] is False
    assert "reference_c" in reply["error"]
    assert len(rig.board.driven) == commands


STOPS = [{"do": "emergency_stop"}, {"do": "maintenance", "minutes": 5}]


@pytest.mark.parametrize("order", STOPS)
def test_a_stop_is_on_the_board_before_the_disk_and_answered_after_it(
    rig: LoopRig, order: dict[str, Any]
) -> None:
    rig.tick()
    rig.disk_works = False
    assert rig.ask(order) == {}  # nobody is answered yet, and the loop has not waited
    assert rig.board.stopped or rig.board.maintained
    assert is_safe(rig.tick().sent)


@pytest.mark.parametrize(
    "order", [*STOPS, {"do": "release_emergency_stop"}, {"do": "set_mode", "mode": "off"}]
)
def test_an_order_that_the_disk_does_not_take_is_in_force_and_says_that_it_will_not_last(
    rig: LoopRig, order: dict[str, Any]
) -> None:
    rig.tick()
    rig.disk_works = False
    answers: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    rig.loop._answer(Letter(order, answers))
    rig.save_answers.pop()("No space left on device")
    answer = answers.get_nowait()
    assert answer["ok"] is False
    assert "in force now, but it will not survive a restart" in answer["error"]
    assert "No space left on device" in answer["error"]


@pytest.mark.parametrize("order", STOPS)
def test_a_stop_without_a_link_says_so_and_reaches_the_board_later(
    rig: LoopRig, order: dict[str, Any]
) -> None:
    rig.tick()
    rig.board.link_up = False
    answer = rig.ask(order)
    assert answer["ok"] and "no link to the board" in answer["warning"]


def test_a_stop_given_again_goes_to_the_board_again(rig: LoopRig) -> None:
    rig.tick()
    assert rig.ask({"do": "emergency_stop"})["changed"]
    assert not rig.ask({"do": "emergency_stop"})["changed"]
    assert rig.board.stops == 2
    assert rig.tick() and rig.events().count("operator.order") == 1


NOTHING_TO_END = [
    ({"do": "release_emergency_stop"}, "there is no emergency stop."),
    ({"do": "maintenance", "minutes": 0}, "there is no maintenance."),
    ({"do": "clear_trip"}, "no trip is latched."),
    ({"do": "set_mode", "mode": "auto"}, "in mode auto, MPC controls the heater and the fan."),
    ({"do": "set_controller", "name": "MPC"}, "in mode auto, MPC controls the heater and the fan."),
    ({"do": "set_reference", "reference_c": None}, "holding the configured set point."),
]


@pytest.mark.parametrize(("order", "holds"), NOTHING_TO_END)
def test_an_order_that_changes_nothing_says_so_and_records_nothing(
    rig: LoopRig, order: dict[str, Any], holds: str
) -> None:
    rig.tick()
    reply = rig.ask({**order, "by": "Ann"})
    said = (True, False, f"Nothing changed: {holds}")
    assert (reply["ok"], reply["changed"], reply["message"]) == said
    rig.tick()
    assert not {"operator.order", "operator.clear_trip"} & set(rig.events())


@pytest.mark.parametrize(
    ("held", "order", "message"),
    [
        ("stopped", {"do": "release_emergency_stop"}, "The board's emergency stop is over."),
        ("maintained", {"do": "maintenance", "minutes": 0}, "The board's maintenance is over."),
        ("tripped", {"do": "clear_trip"}, "Trips are cleared: over_temperature."),
    ],
)
def test_the_end_of_what_only_the_board_holds_reaches_the_board_and_is_recorded(
    rig: LoopRig, held: str, order: dict[str, Any], message: str
) -> None:
    rig.tick()
    setattr(rig.board, held, True)
    rig.board.drive(Command(), False, 1.0)
    reply = rig.ask({**order, "by": "Ann"})
    assert (reply["changed"], reply["message"], getattr(rig.board, held)) == (True, message, False)
    assert f"{message} Ordered by Ann." in [event.text for event in rig.tick().events]
    assert not rig.ask(order)["changed"]


def test_a_trip_that_the_board_keeps_is_not_called_cleared(rig: LoopRig) -> None:
    rig.tick()
    rig.board.tripped = rig.board.keeps_trip = True
    rig.board.drive(Command(), False, 1.0)
    reply = rig.ask({"do": "clear_trip"})
    assert not reply["changed"]
    assert "holds its trip, over_temperature, as long as its cause lasts" in reply["message"]


def test_a_status_shows_maintenance_until_its_end_and_no_longer(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 1})
    for after_s, ticks, shown in ((59.0, 0, True), (2.0, 0, True), (0.0, 1, False), (14 * 3600.0, 0, False)):
        rig.clock.now_s += after_s
        for _ in range(ticks):
            rig.tick(0.0)
        status = rig.ask({"do": "status"})
        assert (status["operation"]["maintenance_until_utc"] is not None) is shown
        assert any("MAINTENANCE" in line for line in status_lines(status)) is shown
        assert (state(status, {})["maintenance"], state(status, {})["tripped"]) == (shown, 0)


def test_status_right_after_a_stop_shows_the_pins_of_now(rig: LoopRig) -> None:
    rig.chosen.command = Command(heater_duty=0.75, fan_on=True)
    assert rig.tick().echo.heater_duty == 0.75
    rig.ask({"do": "emergency_stop"})
    echo = rig.ask({"do": "status"})["echo"]
    assert (echo["heater_duty"], echo["fan_on"], echo["trip_cause"]) == (0.0, 0, "emergency_stop")
    assert rig.shown[-1].heater_duty == 0.0  # published, not a tick later


@pytest.mark.parametrize("order", [{"do": "set_reference", "reference_c": 26}, *STOPS])
def test_every_order_is_published_at_once(rig: LoopRig, order: dict[str, Any]) -> None:
    rig.tick()
    before = len(rig.shown)
    rig.ask(order)
    assert len(rig.shown) == before + 1


def test_what_the_board_changes_between_two_ticks_is_published_once(rig: LoopRig) -> None:
    rig.tick()
    rig.loop._serve_and_answer(rig.clock.now_s)
    assert len(rig.shown) == 1  # by the tick itself
    rig.board.tripped = True
    rig.board.drive(Command(), False, 1.0)
    rig.loop._serve_and_answer(rig.clock.now_s)
    rig.loop._serve_and_answer(rig.clock.now_s)
    assert [echo.tripped for echo in rig.shown] == [False, True]


def test_the_board_is_released_when_maintenance_ends_by_itself(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 2})
    assert is_safe(rig.tick(61.0).sent)
    assert rig.board.maintained
    record = rig.tick(60.0)
    assert not rig.board.maintained
    assert "maintenance.ended" in {event.key for event in record.events}
    assert rig.tick().sent.heater_duty == 0.5


def test_the_end_of_maintenance_leaves_an_emergency_stop_alone(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "emergency_stop"})
    rig.ask({"do": "maintenance", "minutes": 1})
    rig.tick(120.0)
    assert rig.board.stopped and not rig.board.maintained
    assert is_safe(rig.tick().sent)


@pytest.mark.parametrize("cause", ["stopped", "maintained"])
def test_a_stop_that_only_the_board_knows_of_holds_everything_off(rig: LoopRig, cause: str) -> None:
    rig.chosen.command = Command(heater_duty=0.5, fan_on=True, led=0.5)
    rig.tick()
    setattr(rig.board, cause, True)
    rig.board.drive(Command(), False, 1.0)
    assert rig.tick().sent == Command()
    rig.ask({"do": "release_emergency_stop"} if cause == "stopped" else {"do": "maintenance", "minutes": 0})
    assert rig.tick().sent.heater_duty == 0.5


@pytest.mark.parametrize("standing", [{"emergency_stop": True}, {"maintenance_until_utc": UTC_0 + 3600.0}])
def test_a_restarted_loop_stops_the_board_before_the_first_tick(
    rig: LoopRig, standing: dict[str, Any]
) -> None:
    rig.loop.close()
    rig.loop = Loop(rig.rig, Operation("MPC", **standing), SafetyMemory(), first_seq=1)
    rig.loop.stop()
    rig.loop.run()
    assert rig.board.stopped is ("emergency_stop" in standing)
    assert rig.board.maintained is ("emergency_stop" not in standing)


def test_maintenance_that_ended_while_no_daemon_ran_is_ended_on_the_board(rig: LoopRig) -> None:
    rig.board.maintained = True
    rig.board.drive(Command(), False, 1.0)
    rig.loop.close()
    rig.loop = Loop(rig.rig, Operation("MPC", maintenance_until_utc=UTC_0 - 1.0), SafetyMemory(), first_seq=1)
    rig.tick()
    assert not rig.board.maintained


def hands_in(rig: LoopRig) -> bool:
    rig.chosen.command = Command(heater_duty=0.5, fan_on=True)
    sent = rig.tick().sent
    assert (sent == Command()) is rig.board.maintained
    return rig.board.maintained


@pytest.mark.parametrize("jump_s", [-10 * 86400.0, -3600.0, 3600.0, 10 * 86400.0])
def test_maintenance_lasts_as_long_as_was_said_when_the_wall_clock_is_set(
    rig: LoopRig, jump_s: float
) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 30})
    assert hands_in(rig)
    rig.clock.utc_offset += jump_s
    rig.clock.now_s += 60.0
    assert hands_in(rig)
    rig.clock.now_s += 25 * 60.0
    assert hands_in(rig)
    rig.clock.now_s += 10 * 60.0
    assert not hands_in(rig)


def test_a_clock_that_finds_the_date_again_ends_a_maintenance_of_before(rig: LoopRig) -> None:
    rig.loop.close()
    rig.clock.utc_offset -= 300 * 86400.0
    rig.loop = Loop(rig.rig, Operation("MPC", maintenance_until_utc=UTC_0 - 1.0), SafetyMemory(), first_seq=1)
    rig.chosen.command = Command(heater_duty=0.5)
    assert rig.tick().sent == Command()  # nobody knows whether it is over
    rig.clock.utc_offset += 300 * 86400.0
    rig.tick()
    assert rig.tick().sent.heater_duty == 0.5


@pytest.mark.parametrize(
    ("stop", "release"),
    [
        ({"do": "emergency_stop"}, {"do": "release_emergency_stop"}),
        ({"do": "maintenance", "minutes": 30}, {"do": "maintenance", "minutes": 0}),
    ],
)
def test_stops_are_always_obeyed_but_releases_wear_the_board_and_are_limited(
    rig: LoopRig, stop: dict[str, Any], release: dict[str, Any]
) -> None:
    rig.tick()
    for _ in range(RELEASES):
        rig.ask(stop)
        rig.ask(release)
    rig.ask(stop)
    assert "wears the board's memory" in rig.ask(release)["error"]
    assert rig.board.stopped or rig.board.maintained
    rig.clock.now_s += RELEASE_EVERY_S
    assert rig.ask(release)["ok"]
    assert not rig.board.stopped and not rig.board.maintained


def test_status_is_plain_json(rig: LoopRig) -> None:
    rig.tick()
    status = rig.ask({"do": "status"})
    assert json.loads(json.dumps(status, allow_nan=False))["tick"]["seq"] == 1


def test_requests_from_another_thread_are_answered_while_the_loop_runs(rig: LoopRig) -> None:
    replies: list[dict[str, Any]] = []
    asker = threading.Thread(target=lambda: replies.append(rig.inbox.ask({"do": "status"})))

    def ask_once(record: TickRecord) -> None:
        if record.seq == 1:
            asker.start()
            assert select.select([rig.inbox.wake], [], [], 5.0)[0]

    run_until(rig, 3, ask_once)
    asker.join(timeout=5.0)
    assert replies[0]["ok"]


def test_a_request_is_answered_before_the_board_is_there(rig: LoopRig) -> None:
    rig.board.link_up = False
    waits: list[float] = []

    def serve(until_s: float, wake: int | None = None, done: Callable[[], bool] = bool) -> None:
        waits.append(until_s)
        assert len(waits) < 1000, "a request that nobody takes holds up time for ever"
        if wake is None or not select.select([wake], [], [], 0.0)[0]:
            rig.clock.wait(None, wake, until_s)

    rig.board.serve = serve
    replies: list[dict[str, Any]] = []
    asker = threading.Thread(target=lambda: replies.append(rig.inbox.ask({"do": "emergency_stop"})))
    asker.start()
    assert select.select([rig.inbox.wake], [], [], 5.0)[0]
    records = run_until(rig, 1)
    asker.join(timeout=5.0)
    assert replies[0]["ok"]
    assert rig.board.stops == 1
    assert records[0].mode == "emergency_stop"


def test_a_new_controller_takes_over_without_a_bump(rig: LoopRig) -> None:
    rig.tick()
    rig.fallback.command = rig.chosen.command
    rig.ask({"do": "set_controller", "name": "rules"})
    record = rig.tick()
    assert record.decision.controller == "rules"
    assert record.sent == rig.sink.records[0].sent


@pytest.mark.slow
def test_a_stop_is_obeyed_while_a_controller_thinks_and_the_tick_ends_under_it(rig: LoopRig) -> None:
    rig.tick()
    rig.chosen.hang_s = 2.0
    rig.loop._decider._deadline_s = 4.0
    obeyed_s: list[float] = []
    asked_s = time.monotonic() + 0.3

    def stop() -> None:
        rig.inbox.post({"do": "emergency_stop"}, lambda reply: obeyed_s.append(time.monotonic() - asked_s))

    timer = threading.Timer(0.3, stop)
    timer.start()
    record = rig.tick()
    timer.join()
    assert rig.board.stops == 1
    assert obeyed_s[0] < 1.0
    assert record.decision.controller == "MPC"  # the decision was waited for
    assert record.sent.heater_duty == 0.0


def test_between_two_requests_of_a_flood_the_line_is_served(rig: LoopRig) -> None:
    served: list[float] = []
    serve = rig.board.serve

    def counted(until_s: float, wake: int | None = None, done: Callable[[], bool] = bool) -> None:
        served.append(until_s)
        serve(until_s, wake, done)

    rig.board.serve = counted
    for number in range(10):
        rig.inbox.post({"do": "set_reference", "reference_c": 20.0 + number}, lambda reply: None)
    while rig.loop._operation.reference_c != 29.0:
        rig.loop._serve_and_answer(rig.clock.now_s)
    assert len(served) == 10


def test_stops_without_end_while_a_controller_thinks_do_not_hold_up_the_tick(rig: LoopRig) -> None:
    rig.tick()
    rig.chosen.hang_s = 0.5
    rig.loop._decider._deadline_s = 1.0
    take = rig.inbox.take
    taken: list[int] = []

    def never_empty(lanes: int = ORDINARY + 1) -> Letter | None:
        taken.append(lanes)
        assert len(taken) < 1000, "the tick never ends"
        rig.inbox.post({"do": "emergency_stop"}, lambda reply: None)
        return take(lanes)

    rig.inbox.take = never_empty
    assert rig.tick().sent.heater_duty == 0.0
    assert 1 <= len(taken) <= 10


def test_another_board_is_an_alarm_of_its_own_until_it_is_accepted(rig: LoopRig) -> None:
    rig.tick()
    rig.board.foreign, rig.board.link_up = "board 2 answers, board 1 is pinned", False
    record = rig.tick()
    assert record.sent == Command() and record.changes[-1].reason == "another board is at the port"
    event = next(event for event in record.events if event.key == "board.foreign")
    assert event.severity is Severity.ALARM and "board 2 answers" in event.text
    assert rig.ask({"do": "status"})["foreign_board"] == rig.board.foreign
    for order in STOPS:
        assert "another board is at the port and gets stops alone" in rig.ask(order)["warning"]
    for order in ({"do": "release_emergency_stop"}, {"do": "maintenance", "minutes": 0}):
        rig.ask(order)
    assert rig.ask({"do": "accept_board", "by": "me"})["message"] == "Board 2 is this rig's."
    assert rig.tick().sent.heater_duty > 0.0
    assert {"operator.accept_board", "board.foreign.over"} <= set(rig.events())
    assert "board.link_down" not in rig.events()
    again = rig.ask({"do": "accept_board"})
    assert (again["ok"], again["changed"], again["message"]) == (True, False, "Nothing changed.")


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


def test_a_person_accepts_air_that_fell_below_the_room(rig):
    """The loop's board has a room of 21 °C."""
    rig.chosen.command = Command(heater_duty=1.0)
    rig.tick()
    rig.board.temp_air = 2.0
    rig.tick()
    assert "air.jump_contradicted" in rig.events()
    assert rig.tick().sent.heater_duty < 1.0
    assert rig.ask({"do": "clear_trip"})["ok"]
    record = rig.tick()
    assert record.sent.heater_duty == 1.0
    texts = {event.key: event.text for event in record.events}
    assert "air temperature is accepted" in texts["operator.clear_trip"]
    assert "air.jump_contradicted.over" in texts


@pytest.mark.parametrize(("most", "is_told"), [(1.0, True), (0.0, False)])
def test_a_heater_of_unknown_power_is_an_alarm_where_heat_is_allowed(rig, most, is_told):
    rig.chosen.command = Command(heater_duty=1.0)
    safety = replace(rig.settings.safety, heater_max_duty=most)
    rig.loop._rig = replace(rig.rig, box=paper_box(0.0), settings=replace(rig.settings, safety=safety))
    assert rig.tick().sent.heater_duty == 0.0
    assert ("heater.unknown_power" in rig.events()) is is_told
