"""Step tests that hands interrupt: what is driven, what is left out, how long they last; and a later rest."""

import os
import select
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from edge.app import step_test_record
from edge.app.commission import learn
from edge.app.step_test_record import STEP_S, record
from edge.app.step_test_rows import GRACE_S, PAUSES, STOPPED, join, stretches
from edge.board.virtual_rig import settings_in
from edge.commands.hands import Hands
from edge.config.settings import ControlSettings, Settings
from edge.formats.run_file import RecordedRun
from edge.sockets.client import request
from edge.sockets.control_socket import ControlSocket
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import read_twin_file
from training.lab import InProcessBoard

pytestmark = pytest.mark.slow

OPEN_S, CLOSED_S = 605.0, 905.0
PAUSE = [
    (OPEN_S, {"do": "maintenance", "minutes": 60.0}),
    (CLOSED_S, {"do": "maintenance", "minutes": 0.0}),
]


class OrderClock:
    """The clock of a board in this process, and a person's requests at their times."""

    def __init__(self, board, socket, orders):
        self.board, self.socket, self.orders = board, socket, list(orders)
        self.driven = []  # time, heater, fan
        self.now, self.utc = board.now, board.utc

    def wait(self, port, wake, until_s):
        next_s = self.orders[0][0] if self.orders and wake is not None else until_s
        self.board.wait(port, wake, min(until_s, next_s))
        plant = self.board.device.plant
        self.driven.append((self.now(), plant.heat, plant.fan))
        if wake is not None and self.orders and self.now() >= self.orders[0][0]:
            order = self.orders.pop(0)[1]
            threading.Thread(target=request, args=(self.socket, order)).start()
            assert select.select([wake], [], [], 60.0)[0]


def recorded(folder, orders, minutes=30.0):
    """A run of the tests on a virtual board, its ticks, what was driven, and what was saved on the way."""
    settings = step_test_record.test_settings(settings_in(folder, Settings(timezone="UTC")))
    ticks, saved, board = [], [], InProcessBoard(1)
    clock = OrderClock(board, folder / "control.sock", orders)

    def show(tick, left):
        ticks.append((tick, left))

    run = record(settings, clock, True, minutes, show, board.open, saved.append)
    return run, ticks, clock.driven, saved


def test_a_pause_drives_nothing_leaves_its_rows_out_and_makes_the_tests_longer(tmp_path):
    run, ticks, driven, saved = recorded(tmp_path, PAUSE)
    inside = [heat or fan for time_s, heat, fan in driven if OPEN_S + 1.0 < time_s < CLOSED_S]
    assert inside and not any(inside)
    heated_s = [tick.time_s for tick, _ in ticks if tick.echo.heater_duty > 0.0]
    assert min(heated_s) < OPEN_S and max(heated_s) > CLOSED_S + 600.0
    assert len(run) == 30 * 60 / STEP_S
    lasted_s = ticks[-1][0].time_s - ticks[0][0].time_s
    assert lasted_s == pytest.approx(30 * 60 + CLOSED_S - OPEN_S + GRACE_S, abs=2 * STEP_S)
    first, second = stretches(run)
    assert 0 < first.columns["time_s"][-1] < OPEN_S
    assert run.columns["time_s"][len(first)] >= CLOSED_S + GRACE_S - 2 * STEP_S
    assert run.facts[PAUSES] and STOPPED not in run.facts
    assert len(first) + len(second) == len(run)
    lefts = [left for tick, left in ticks if OPEN_S < tick.time_s < CLOSED_S]
    assert max(lefts) - min(lefts) <= STEP_S / 60.0
    # The simulated clock outruns the history's thread, so how much each one holds is open.
    assert saved
    for part in saved:
        assert 0 < len(part) < len(run)
        np.testing.assert_array_equal(part.columns["time_s"], run.columns["time_s"][: len(part)])


def test_after_a_pause_in_its_first_legs_the_box_settles_and_they_begin_anew(tmp_path):
    _, ticks, _, _ = recorded(tmp_path, PAUSE, minutes=20.0)
    legs = [str(tick.decision.why["leg"]) for tick, _ in ticks]
    order = [leg for leg, before in zip(legs, [None, *legs], strict=False) if leg != before]
    place = order.index("pause")
    assert order[place : place + 4] == ["pause", "settle", "rest", "fan at rest"]


def test_an_emergency_stop_ends_the_tests_and_keeps_their_rows(tmp_path):
    run, ticks, _, _ = recorded(tmp_path, [(700.0, {"do": "emergency_stop"})])
    assert run.facts[STOPPED] == "emergency stop"
    assert 65 <= len(run) <= 72 and ticks[-1][0].time_s < 720.0


def rows(count, air=25.0, start="2026-01-01T00:00:00.000+00:00", step_s=STEP_S):
    time_s = step_s * np.arange(count)
    columns = {"time_s": time_s, "temp_air_c": np.full(count, air), "heater_duty": np.zeros(count)}
    return RecordedRun(columns, {"start_utc": start} if start else {})


def test_a_later_recording_is_joined_at_the_distance_of_the_clocks():
    whole = join(rows(40), rows(50, 30.0, "2026-01-01T02:00:00+00:00"))
    assert len(whole) == 90 and whole.columns["time_s"][40] == 7200.0
    first, second = stretches(whole)
    assert (len(first), len(second)) == (40, 50)
    assert second.start_utc == pytest.approx(first.start_utc + 7200.0)
    assert set(second.columns["temp_air_c"]) == {30.0}


@pytest.mark.parametrize("start", [None, "2025-01-01T00:00:00+00:00", "2026-01-01T00:00:10+00:00"])
def test_clocks_that_cannot_be_right_leave_a_gap_all_the_same(start):
    first, second = stretches(join(rows(40), rows(50, start=start)))
    assert (len(first), len(second)) == (40, 50)


def test_a_reason_to_stop_is_that_of_the_newest_recording():
    stopped = replace(rows(40), facts={STOPPED: "emergency stop"})
    assert STOPPED not in join(stopped, rows(40)).facts
    assert join(rows(40), stopped).facts[STOPPED] == "emergency stop"


def test_stretches_that_are_too_short_are_left_out_but_never_all():
    whole = join(rows(40), rows(5, start="2026-01-01T02:00:00+00:00"))
    assert [len(part) for part in stretches(whole)] == [40]
    short = join(rows(5), rows(5, start="2026-01-01T02:00:00+00:00"))
    assert [len(part) for part in stretches(short)] == [10]


class MaintenanceAnswers:
    """Answers maintenance on a control socket."""

    def __init__(self, path):
        self.asked = []
        self.socket = ControlSocket(path, lambda asked: {"ok": True}, self.post)

    def post(self, asked, answered):
        self.asked.append(dict(asked))
        answered({"ok": True})


def wait(condition):
    give_up = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up
        time.sleep(0.01)


def test_typed_lines_pause_and_go_on_and_others_are_explained(tmp_path):
    daemon, said = MaintenanceAnswers(tmp_path / "control.sock"), []
    read, write = os.pipe()
    try:
        with Hands(tmp_path / "control.sock", said.append, read):
            for line, count in ((b"p\n", 1), (b"what\n", 2), (b"g\n", 3)):
                os.write(write, line)
                wait(lambda count=count: len(said) == count)
    finally:
        os.close(read)
        os.close(write)
        daemon.socket.close()
    assert [asked["minutes"] for asked in daemon.asked] == [60.0, 0.0]
    assert "paused" in said[0] and "p and Enter" in said[1] and "settles" in said[2]


def test_a_line_without_a_daemon_is_answered_with_the_reason(tmp_path):
    said = []
    read, write = os.pipe()
    with Hands(tmp_path / "none.sock", said.append, read):
        os.write(write, b"p\n")
        wait(lambda: said)
    os.close(read)
    os.close(write)
    assert said[0].startswith("not done: no daemon listens")


def test_the_end_of_input_ends_the_thread(tmp_path):
    read, write = os.pipe()
    os.close(write)
    before = threading.active_count()
    with Hands(tmp_path / "none.sock", print, read):
        wait(lambda: threading.active_count() == before)
    os.close(read)


def test_a_pause_that_nobody_ends_is_over_after_its_hour(tmp_path):
    run, ticks, _, _ = recorded(tmp_path, PAUSE[:1], minutes=15.0)
    assert len(run) == 90
    lasted_min = (ticks[-1][0].time_s - ticks[0][0].time_s) / 60.0
    assert lasted_min == pytest.approx(15.0 + 60.0 + GRACE_S / 60.0, abs=0.5)


@pytest.mark.timeout(600)
def test_a_twin_is_learned_from_both_sides_of_a_pause_and_knows_the_steps_of_its_sensor(tmp_path):
    run, *_ = recorded(tmp_path, PAUSE, minutes=50.0)
    coarse = {"temp_air_c": np.round(2.0 * run.columns["temp_air_c"]) / 2.0}
    run = replace(run, columns={**run.columns, **coarse})
    path = tmp_path / "box.yaml"
    path.write_text(text(BoxDescription(0.15, 100.0, "exhaust", 68.0)))
    found = learn(run, read_twin_file(path), ControlSettings(), lambda said, share: None)
    names = {item.name for item in found.diagnosis.data.train}
    assert names == {"tests 1", "tests 2"}
    assert [item.rest_of for item in found.diagnosis.data.test] == ["tests 2"]  # the first has ten minutes
    assert found.expectation.error_k < 1.0
    assert found.twin.sensor["quantisation_k"] == 0.5
