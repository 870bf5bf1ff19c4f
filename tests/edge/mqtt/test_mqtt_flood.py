"""Floods over MQTT: a stop is not held up, and the flood is refused from the cheap side."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from edge.core.event_log import Allowance
from edge.mqtt.telemetry import COMMANDS_WAITING_MAX, Telemetry
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.mqtt_rig import ROOT as TOPICS
from tests.support.mqtt_rig import ControlLoop, MemoryOutbox, settings
from tests.support.virtual_board import virtual_board

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

# Behind a flood it would wait for minutes; `python -m bench attack` shows how long it does.
HELD_UP_S = 30.0  # without a connection of its own a stop waits for the whole flood, many minutes
FLOOD = """
import sys
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
client = Client(CallbackAPIVersion.VERSION2)
client.max_queued_messages_set(0)
client.max_inflight_messages_set(1000)
client.connect("127.0.0.1", int(sys.argv[1]))
client.loop_start()
topic, payload, count, qos = sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
last = None
for number in range(count):
    last = client.publish(topic, payload, qos=qos)
    if number == 0:
        print("begun", flush=True)
    if number % 200 == 0:
        last.wait_for_publish(30)
last.wait_for_publish(30)
"""


@contextmanager
def flood(port: int, what: str, payload: str, count: int = 10_000, qos: int = 1) -> Iterator[Any]:
    """Another process that publishes without a pause, from its first message on."""
    command = [sys.executable, "-c", FLOOD, str(port), f"{RIG}/set/{what}", payload, str(count), str(qos)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def is_stopped(daemon: DaemonProcess) -> bool:
    return bool(daemon.ask("status")["operation"]["emergency_stop"])


@needs_mosquitto
@pytest.mark.parametrize(
    ("what", "payload", "qos"),
    [("status", "PRESS", 1), ("mode", "heat", 0), ("manual", "x" * 500, 1), ("maintenance", "junk", 1)],
)
def test_a_stop_in_a_flood_is_not_held_up(folder: Path, what: str, payload: str, qos: int) -> None:
    with (
        virtual_board(folder, "--real-time"),
        Broker(folder) as broker,
        DaemonProcess(folder, broker.port) as daemon,
        Listener(broker.port, f"{RIG}/state") as listener,
    ):
        wait_for(lambda: listener.payloads(f"{RIG}/state"))
        waits = []
        with flood(broker.port, what, payload, 10**6, qos):
            time.sleep(0.5)
            for _ in range(2):
                listener.client.publish(f"{RIG}/set/emergency_stop", "PRESS", qos=1)
                begun = time.monotonic()
                wait_for(lambda: is_stopped(daemon), patience_s=HELD_UP_S)
                waits.append(time.monotonic() - begun)
                assert daemon.ask("release_emergency_stop")["ok"]
        assert max(waits) < HELD_UP_S, waits
        if what != "maintenance":
            wait_for(lambda: daemon.has_event("telemetry.flooded"))


@needs_mosquitto
def test_a_stop_behind_ten_thousand_messages_is_not_held_up(folder: Path) -> None:
    with (
        virtual_board(folder, "--real-time"),
        Broker(folder) as broker,
        DaemonProcess(folder, broker.port) as daemon,
        Listener(broker.port, f"{RIG}/reply") as listener,
    ):
        wait_for(lambda: "online" in broker.log or daemon.seq() > 1)
        used_s, ticks = cpu_s(daemon.process.pid), daemon.seq()
        with flood(broker.port, "status", "PRESS") as process:
            assert process.wait(60) == 0
            listener.client.publish(f"{RIG}/set/emergency_stop", "PRESS", qos=1)
            begun = time.monotonic()
            wait_for(lambda: is_stopped(daemon))
            assert time.monotonic() - begun < HELD_UP_S
        used_s = cpu_s(daemon.process.pid) - used_s
        wait_for(
            lambda: any("refused" in reply.get("error", "") for reply in listener.objects(f"{RIG}/reply"))
        )
        assert len(listener.objects(f"{RIG}/reply")) < 300  # not one for each message
        assert daemon.seq() > ticks
        print(f"CPU for 10 000 messages: {used_s:.2f} s")


@contextmanager
def running(port: int, loop: ControlLoop) -> Iterator[Telemetry]:
    own = Telemetry(settings(port), loop.ask, loop.post, MemoryOutbox)
    wait_for(lambda: all(lane.is_open for lane in own._lanes) and not own.faults())
    try:
        yield own
    finally:
        own.close()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as there:
        yield there


@needs_mosquitto
def test_each_urgent_order_is_carried_out_once_and_in_order(broker: Broker) -> None:
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop):
        orders = ["emergency_stop", "release_emergency_stop"] * 3
        for what in orders:
            listener.send(f"{TOPICS}/set/{what}", "PRESS")
        for payload in ("ON", "OFF"):  # of Home Assistant's switch
            listener.send(f"{TOPICS}/set/emergency_stop", payload)
        wait_for(lambda: len(loop.requests) >= 8)
        time.sleep(0.5)
        assert [request["do"] for request in loop.requests] == [*orders, *orders[:2]]


@needs_mosquitto
def test_a_stop_is_heard_where_its_own_connection_has_died_unnoticed(broker: Broker) -> None:
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop) as own:
        own._lane_of["emergency_stop"]._client.on_message = lambda *_: None
        listener.send(f"{TOPICS}/set/emergency_stop", "PRESS")
        wait_for(lambda: loop.operation.emergency_stop)


@needs_mosquitto
def test_a_stop_by_the_main_connection_alone_acts_after_a_release_by_the_switch(
    broker: Broker,
) -> None:
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop) as own:
        listener.send(f"{TOPICS}/set/emergency_stop", "OFF")
        wait_for(lambda: loop.requests)
        own._lane_of["emergency_stop"]._client.on_message = lambda *_: None
        listener.send(f"{TOPICS}/set/emergency_stop", "ON")
        wait_for(lambda: loop.operation.emergency_stop)


@needs_mosquitto
def test_without_its_own_connection_every_urgent_order_comes_by_the_main_one(broker: Broker) -> None:
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop) as own:
        for lane in own._lanes:
            lane.close()
        wait_for(lambda: not any(lane.is_open for lane in own._lanes))
        for what, payload in (("emergency_stop", "PRESS"), ("maintenance", "30")):
            listener.send(f"{TOPICS}/set/{what}", payload)
        wait_for(lambda: len(loop.requests) == 2)


@needs_mosquitto
def test_a_retained_stop_never_acts(broker: Broker) -> None:
    loop = ControlLoop()
    with Listener(broker.port) as listener:
        listener.send(f"{TOPICS}/set/emergency_stop", "PRESS", retain=True)
        with running(broker.port, loop):
            listener.send(f"{TOPICS}/set/maintenance", "30")
            wait_for(lambda: loop.requests)
            assert [request["do"] for request in loop.requests] == ["maintenance"]


@needs_mosquitto
def test_after_a_broken_connection_the_lanes_are_open_again(broker: Broker) -> None:
    loop = ControlLoop()
    with running(broker.port, loop) as own:
        broker.stop()
        wait_for(lambda: not any(lane.is_open for lane in own._lanes))
        broker.start()
        wait_for(lambda: all(lane.is_open for lane in own._lanes))
        with Listener(broker.port) as listener:
            listener.send(f"{TOPICS}/set/emergency_stop", "PRESS")
            wait_for(lambda: loop.operation.emergency_stop)


@needs_mosquitto
def test_what_a_flood_had_refused_is_told_in_one_answer(broker: Broker) -> None:
    with Listener(broker.port) as listener, running(broker.port, ControlLoop()) as own:
        for _ in range(500):
            listener.client.publish(f"{TOPICS}/set/undo", "PRESS", qos=1)
        wait_for(lambda: own._allowance.refused > 400)
        assert "telemetry.flooded" in own.faults()
        told = f"{TOPICS}/reply"
        wait_for(lambda: any(reply["command"] == "" for reply in listener.objects(told)))
        assert len(listener.objects(told)) < 2 * COMMANDS_WAITING_MAX


def test_an_allowance_lets_a_burst_in_and_then_so_many_a_second() -> None:
    now = [0.0]
    allowance = Allowance(3, 2.0, lambda: now[0])
    assert [allowance.take() for _ in range(5)] == [True, True, True, False, False]
    assert allowance.refused == 2
    now[0] = 1.0
    assert [allowance.take() for _ in range(3)] == [True, True, False]
    now[0] = 100.0
    assert [allowance.take() for _ in range(4)] == [True, True, True, False]  # no more than the burst
