"""The whole daemon as a process, with a board and a broker: each part is killed in turn.

Control goes on or ends safely, and what was recorded is not lost.
"""

import json
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from edge.__main__ import main
from tests.support.broker import KEEPS_SESSIONS, Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, ROOT, DaemonProcess, run_command
from tests.support.virtual_board import VirtualBoard, virtual_board

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

LEASE_S = 10.0  # firmware_protocol/PROTOCOL.md
TICKS = f"{RIG}/history/tick"


@contextmanager
def rig_with_broker(folder: Path, *config: str) -> Iterator[tuple[Broker, Listener, DaemonProcess]]:
    with (
        Broker(folder, *config) as broker,
        Listener(broker.port, TICKS) as listener,
        DaemonProcess(folder, broker.port) as daemon,
    ):
        yield broker, listener, daemon


def heats(board: VirtualBoard) -> bool:
    return bool(board.truth()["pins"]["heater_relay"])


def heard(listener: Listener) -> list[tuple[str, int]]:
    """History and number of each tick that a subscriber has heard, first hearing only."""
    return list(dict.fromkeys((tick["history_id"], tick["seq"]) for tick in listener.objects(TICKS)))


def saved(daemon: DaemonProcess) -> dict[str, Any]:
    """Standing orders and trips on disk."""
    return json.loads(daemon.state_file.read_text()) if daemon.state_file.exists() else {}


def is_without_gap(seqs: list[int]) -> bool:
    return seqs == list(range(seqs[0], seqs[0] + len(seqs)))


# the board


def test_a_board_that_comes_late_dies_and_returns_is_told_and_found_each_time(folder: Path) -> None:
    with DaemonProcess(folder) as daemon:
        wait_for(lambda: daemon.has_event("board.port_missing"))
        with virtual_board(folder, "--real-time") as board:
            wait_for(lambda: heats(board))
            board.process.kill()
            board.process.wait()
            board.port.unlink()  # as udev does; what it points to may soon be another test's board
            wait_for(lambda: daemon.ask("status")["echo"] is None)
            daemon.wait_ticks(2)
        with virtual_board(folder, "--real-time") as board:
            wait_for(lambda: heats(board))
            last = daemon.wait_ticks(2)
        wait_for(lambda: daemon.seqs()[-1] >= last)
        assert is_without_gap(daemon.seqs())
        keys = [key for (key,) in daemon.rows("SELECT key FROM events ORDER BY seq, number")]
        assert "board.unplugged" in keys, keys
        lost = keys.index("board.unplugged")
        assert "board.link_down" in keys[lost:]
        assert "board.link_up" in keys[lost:]
        down = daemon.rows("SELECT DISTINCT echo_heater_duty FROM ticks WHERE link_up = 0")
        assert down == [(None,)]  # what nobody confirms counts as off


# the broker


@needs_mosquitto
def test_control_goes_on_without_a_broker_and_ticks_arrive_later(folder: Path, board: VirtualBoard) -> None:
    with rig_with_broker(folder, KEEPS_SESSIONS) as (broker, listener, daemon):
        wait_for(lambda: len(heard(listener)) > 1)
        broker.stop()
        first = daemon.seq() + 1
        last = daemon.wait_ticks(2)
        broker.start()
        wait_for(lambda: heard(listener)[-1][1] > last)
        histories, seqs = zip(*heard(listener), strict=True)
        assert len(set(histories)) == 1
        assert is_without_gap(list(seqs))
        assert is_without_gap(daemon.seqs())
        confirmed = f"seq BETWEEN {first} AND {last} AND echo_heater_duty NOTNULL"
        ((count,),) = daemon.rows(f"SELECT count(*) FROM ticks WHERE {confirmed}")
        assert count >= last - first  # on a busy machine a board in real time may answer one of them late
        wait_for(lambda: daemon.has_event("telemetry.offline.over"))


@needs_mosquitto
def test_what_a_killed_broker_lost_is_a_gap_that_a_resend_fills(folder: Path, board: VirtualBoard) -> None:
    with rig_with_broker(folder) as (broker, listener, daemon):
        wait_for(lambda: len(heard(listener)) > 1)
        broker.kill()
        daemon.wait_ticks(1)
        broker.start()
        listener.wait_until_subscribed()
        last = daemon.wait_ticks(1)
        wait_for(lambda: heard(listener)[-1][1] >= last)
        # The subscriber was told of its gaps, if any, by the numbers; this fills them.
        assert daemon.ask("resend", first_seq=1, last_seq=last)["queued"] >= last
        wait_for(lambda: {seq for _, seq in heard(listener)} >= set(range(1, last + 1)))


# the history


@pytest.mark.parametrize("way", ["deleted", "overwritten with garbage"])
def test_a_history_that_is_lost_is_begun_anew_and_says_what_went_with_it(
    folder: Path, board: VirtualBoard, way: str
) -> None:
    with DaemonProcess(folder) as daemon:
        last = daemon.wait_ticks(1)
        wait_for(lambda: daemon.seqs()[-1] >= last)
        if way == "deleted":
            for path in folder.glob("history.db*"):
                path.unlink()
        else:
            for path in (daemon.history, folder / "history.db-wal"):  # a young history is all in its log
                path.write_bytes(bytes(range(256)) * 400)
            wait_for(lambda: list(folder.glob("history.db.aside-*")))
        wait_for(lambda: daemon.has_event("history.replaced"))
        assert len(list(folder.glob("history.db.aside-*Z"))) == (way != "deleted")
        ((first_lost, last_lost),) = daemon.rows("SELECT first_seq, last_seq FROM gaps")
        assert first_lost == 1
        assert daemon.seqs()[0] == last_lost + 1  # none is missing beside those in the file
        assert is_without_gap(daemon.seqs())
        assert daemon.rows("PRAGMA integrity_check") == [("ok",)]
        assert heats(board)


def test_a_history_locked_by_another_process_loses_nothing(folder: Path, board: VirtualBoard) -> None:
    with DaemonProcess(folder) as daemon:
        daemon.wait_ticks(1)
        with closing(sqlite3.connect(daemon.history, timeout=10.0, isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            last = daemon.wait_ticks(3)
            other.execute("ROLLBACK")
        wait_for(lambda: daemon.seqs()[-1] >= last)
        assert daemon.seqs()[0] == 1
        assert is_without_gap(daemon.seqs())
        wait_for(lambda: daemon.has_event("history.behind.over"))
        assert daemon.rows("SELECT * FROM gaps") == []


# the daemon


@needs_mosquitto
def test_a_killed_daemon_leaves_no_heat_and_goes_on_where_it_was(folder: Path, board: VirtualBoard) -> None:
    with rig_with_broker(folder, KEEPS_SESSIONS) as (broker, listener, daemon):
        assert daemon.ask("set_mode", mode="heat")["ok"]
        assert daemon.ask("set_reference", reference_c=33)["ok"]
        wait_for(lambda: saved(daemon).get("operation", {}).get("reference_c") == 33)
        wait_for(lambda: heats(board))
        broker.stop()
        last = daemon.wait_ticks(2)
        wait_for(lambda: daemon.seqs()[-1] >= last)
        killed_at_s = board.truth()["time_s"]
        daemon.kill()
        stored = daemon.seqs()
        assert daemon.rows("PRAGMA integrity_check") == [("ok",)]

        wait_for(lambda: not heats(board))
        assert board.truth()["heater_pin_last_on_s"] <= killed_at_s + LEASE_S + 1.0

        broker.start()
        daemon.start()
        wait_for(lambda: daemon.has_event("history.unclean_stop"))
        operation = daemon.ask("status")["operation"]
        assert (operation["mode"], operation["reference_c"]) == ("heat", 33.0)
        wait_for(lambda: heats(board))
        # The outbox's rest is delivered, and what the numbers leave out is on record.
        wait_for(lambda: {seq for _, seq in heard(listener)} >= set(stored))
        ((first_gap, last_gap),) = daemon.rows("SELECT first_seq, last_seq FROM gaps")
        assert first_gap == stored[-1] + 1
        assert last_gap - first_gap < 60  # no more than seconds have passed
        assert daemon.seqs()[len(stored)] == last_gap + 1


def test_an_emergency_stop_and_a_latched_trip_survive_a_kill(folder: Path, board: VirtualBoard) -> None:
    with DaemonProcess(folder) as daemon:
        wait_for(lambda: heats(board))
        assert "error" not in board.inject(name="sensor_offset", signal="temp_air_c", offset=30.0)
        wait_for(lambda: daemon.ask("status")["trips"])
        trips = daemon.ask("status")["trips"]
        board.ask(clear_faults=True)
        assert daemon.ask("emergency_stop")["ok"]
        wait_for(lambda: saved(daemon)["operation"]["emergency_stop"])
        daemon.kill()
        daemon.start()
        status = daemon.ask("status")
        assert status["operation"]["emergency_stop"]
        assert status["trips"] == trips
        daemon.wait_ticks(1)
        assert not heats(board)
        # Released, the trip still holds.
        assert daemon.ask("release_emergency_stop")["ok"]
        daemon.wait_ticks(2)
        assert not heats(board)


@needs_mosquitto
def test_a_daemon_that_is_told_to_end_turns_all_off_and_says_goodbye(
    folder: Path, board: VirtualBoard
) -> None:
    with (
        Broker(folder) as broker,
        Listener(broker.port, f"{RIG}/availability") as listener,
        DaemonProcess(folder, broker.port) as daemon,
    ):
        wait_for(lambda: heats(board))
        wait_for(lambda: listener.payloads(f"{RIG}/availability") == [b"online"])
        assert daemon.stop() == 0, daemon.log
        assert not heats(board)  # without waiting for any lease
        wait_for(lambda: listener.payloads(f"{RIG}/availability") == [b"online", b"offline"])
        assert not daemon.socket.exists()
        assert daemon.rows("SELECT count(*) FROM sessions WHERE ended_utc IS NULL") == [(0,)]
        assert "Traceback" not in daemon.log


# orders


@needs_mosquitto
def test_orders_over_socket_and_broker_act_at_once_and_end_in_the_same_handler(
    folder: Path, board: VirtualBoard
) -> None:
    with (
        Broker(folder) as broker,
        Listener(broker.port, f"{RIG}/reply") as listener,
        DaemonProcess(folder, broker.port, control={"step_s": 3, "model": "", **RULES}) as daemon,
    ):

        def stop_over_mqtt() -> None:
            answered = len(listener.heard)
            listener.send(f"{RIG}/set/emergency_stop", "PRESS")
            wait_for(lambda: len(listener.heard) > answered)
            reply = listener.objects(f"{RIG}/reply")[-1]
            assert (reply["command"], reply["ok"], reply["changed"]) == ("emergency_stop", True, True)

        for stop in (lambda: daemon.ask("emergency_stop"), stop_over_mqtt):
            wait_for(lambda: heats(board))
            asked_s = board.truth()["time_s"]
            stop()
            wait_for(lambda: not heats(board))
            assert board.truth()["heater_pin_last_on_s"] <= asked_s + 1.0  # not at the next tick, 3 s on
            assert daemon.ask("release_emergency_stop")["ok"]
        daemon.wait_ticks(1)
        wait_for(
            lambda: (
                [text for (text,) in daemon.rows("SELECT text FROM events WHERE key = 'operator.order'")]
                == [
                    "Emergency stop: everything is off until it is released.",
                    "The emergency stop is released.",
                ]
                * 2
            )
        )


RULES = {"controller": "rules", "fallback": "rules"}


# the configuration


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("control: {stepp_s: 1}", "edge.yaml: control: unknown key 'stepp_s'; did you mean 'step_s'?"),
        ("control: {step_s: 7}", "control.step_s is 7"),
        ("control: {model: /nowhere/arx.json}", "/nowhere/arx.json"),
        (None, "edge.yaml: cannot be read"),
    ],
)
def test_a_wrong_or_missing_configuration_is_one_clear_line_and_exit_code_2(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str | None, said: str
) -> None:
    config = folder / "edge.yaml"
    if text is not None:
        places = {"state_file": f"{folder}/state.json", "bundle": {"path": f"{folder}/bundles"}}
        config.write_text(f"{text}\n{yaml.safe_dump(places)}")
    assert main(["run", "--config", str(config)]) == 2
    told = capsys.readouterr()
    assert said in told.err
    assert len(told.err.strip().splitlines()) == 1
    assert told.out == ""


def test_a_second_daemon_is_refused_and_gets_no_board(folder: Path, board: VirtualBoard) -> None:
    with DaemonProcess(folder) as daemon:
        wait_for(lambda: heats(board))
        second = subprocess.run(
            run_command(daemon.config), capture_output=True, text=True, cwd=ROOT, timeout=30
        )
        assert second.returncode == 2
        assert "another daemon uses this file" in second.stderr
        assert len(second.stderr.strip().splitlines()) == 1

        elsewhere = folder / "second"
        elsewhere.mkdir()
        with DaemonProcess(elsewhere, board={"port": str(board.port)}) as other:
            wait_for(lambda: other.has_event("board.port_missing"))
            ((text,),) = other.rows("SELECT text FROM events WHERE key = 'board.port_missing'")
            assert "lock" in text
        last = daemon.wait_ticks(1)
        wait_for(lambda: daemon.seqs()[-1] >= last)
        assert is_without_gap(daemon.seqs())
        assert daemon.rows("SELECT count(*) FROM ticks WHERE NOT link_up OR echo_heater_duty IS NULL") == [
            (0,)
        ]
