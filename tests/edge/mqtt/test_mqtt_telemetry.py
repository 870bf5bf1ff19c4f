import contextlib
import json
import math
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from edge import models
from edge.__main__ import main
from edge.core.errors import ConfigError, RequestError
from edge.core.messages import Echo, Event, Severity
from edge.mqtt import connection, telemetry
from edge.mqtt.telemetry import Telemetry, remove
from edge.mqtt.topics import Topics
from edge.sockets.control_socket import ControlSocket
from edge.twin.twin_file import read_twin_file, write_twin_file
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ROOT, ControlLoop, MemoryOutbox, record, settings, tick

pytestmark = [pytest.mark.usefixtures("quick_reconnect"), needs_mosquitto]
pytest_plugins = ["rig_places"]
AVAILABILITY, STATE, REPLY, EVENT = (f"{ROOT}/{name}" for name in ("availability", "state", "reply", "event"))
DISCOVERY, HISTORY = "homeassistant/device/rig-1/config", f"{ROOT}/history"


@pytest.fixture
def broker(tmp_path):
    with Broker(tmp_path) as running:
        yield running


TWIN_FILE = Path(models.__file__).with_name("default_bundle") / "twin.yaml"


@contextmanager
def running(port, loop=None, outbox=None, own_twin=lambda: TWIN_FILE, **mqtt):
    outbox = outbox or MemoryOutbox()
    loop = loop or ControlLoop()
    own = Telemetry(settings(port, **mqtt), loop.ask, loop.post, lambda: outbox, own_twin)
    try:
        yield own
    finally:
        own.close()


@contextmanager
def online(*arguments):
    """Telemetry that the broker has let in."""
    with running(*arguments) as own:
        wait_for(lambda: not own.faults())
        yield own


def test_a_tick_is_published_with_discovery_and_availability(broker):
    with Listener(broker.port) as listener, running(broker.port) as own:
        tick(own, record())
        wait_for(lambda: listener.payloads(STATE) and listener.payloads(f"{ROOT}/forecast"))
        assert listener.objects(STATE)[-1]["temp_air_c"] == 24.5
        assert listener.objects(f"{ROOT}/decision")[-1]["controller"] == "MPC"
        assert listener.objects(f"{ROOT}/forecast")[-1]["forecast_c"] == [24.9, 25.3]
        assert listener.payloads(AVAILABILITY) == [b"online"]
        assert listener.objects(DISCOVERY)[-1]["components"]["climate"]
        assert not own.faults()


def test_a_late_subscriber_finds_all_that_is_retained(broker):
    with running(broker.port) as own:
        tick(own, record())
        with Listener(broker.port) as listener:
            wanted = {AVAILABILITY, STATE, f"{ROOT}/decision", f"{ROOT}/forecast", DISCOVERY}
            wanted |= {f"{ROOT}/forecasts", f"{ROOT}/skill", f"{ROOT}/drift"}
            wait_for(lambda: wanted <= {message.topic for message in listener.heard})


def test_the_twin_that_runs_is_told_without_its_runs_and_taken_back(broker, tmp_path):
    told_of = {"after": {"train": {"rmse_k": 0.2}}}
    file = replace(read_twin_file(TWIN_FILE), provenance={"runs": ["a-private-run.csv"], **told_of})
    (tmp_path / "box-2").mkdir()
    write_twin_file(file, tmp_path / "box-2" / "twin.yaml")
    own_twin = [None, tmp_path / "box-2" / "twin.yaml", None]
    with Listener(broker.port) as listener, running(broker.port, own_twin=lambda: own_twin[0]):
        wait_for(lambda: listener.payloads(f"{ROOT}/twin") == [b""])
        del own_twin[0]
        wait_for(lambda: len(listener.payloads(f"{ROOT}/twin")) == 2)
        del own_twin[0]
        wait_for(lambda: len(listener.payloads(f"{ROOT}/twin")) == 3)
    _, told, taken_back = listener.payloads(f"{ROOT}/twin")
    assert b"private" not in told and taken_back == b""
    told = json.loads(told)
    assert told["bundle"] == "box-2"
    (tmp_path / "told.yaml").write_text(json.dumps(told["twin"]))
    assert read_twin_file(tmp_path / "told.yaml") == replace(file, provenance=told_of)


def test_replies_events_and_proposals_are_not_retained(broker):
    moment = Event("test.one", Severity.ALARM, "too hot", 0.0, 1.7e9)
    with running(broker.port) as own:
        with Listener(broker.port) as listener:
            wait_for(lambda: not own.faults())
            listener.send(f"{ROOT}/set/temperature", "28.5")
            tick(own, record(events=(moment,)))
            own.show_proposal({"state": "ready"})
            own.show_commissioning({"phase": "idle", "text": "idle"})
            wait_for(lambda: all(listener.payloads(topic) for topic in (REPLY, EVENT, f"{ROOT}/proposal")))
        with Listener(broker.port, name="late") as late:
            allowed = set(Topics.of(settings(broker.port).mqtt).retained)
            wait_for(lambda: allowed <= {message.topic for message in late.heard})
            assert {message.topic for message in late.heard} == allowed


def test_a_message_with_a_value_that_json_lacks_is_not_published(broker):
    with Listener(broker.port) as listener, online(broker.port) as own:
        own.show_proposal({"reference_c": math.nan})
        own.show_proposal({"reference_c": 24.0})
        wait_for(lambda: b'{"reference_c":24.0}' in listener.payloads(f"{ROOT}/proposal"))
        assert [shown.get("state") for shown in listener.objects(f"{ROOT}/proposal")] == ["none", None]


def test_the_newest_proposal_comes_again_when_home_assistant_starts(broker):
    with Listener(broker.port) as listener, online(broker.port) as own:
        own.show_proposal({"id": "a", "state": "ready"})
        wait_for(lambda: listener.objects(f"{ROOT}/proposal")[-1:] == [{"id": "a", "state": "ready"}])
        listener.heard.clear()
        listener.send("homeassistant/status", "online")
        wait_for(lambda: listener.objects(f"{ROOT}/proposal") == [{"id": "a", "state": "ready"}])


def test_closing_says_offline(broker):
    with Listener(broker.port) as listener:
        with online(broker.port):
            pass
        wait_for(lambda: listener.payloads(AVAILABILITY) == [b"online", b"offline"])


def test_the_last_will_speaks_for_a_killed_process(broker):
    program = (
        "from tests.support.mqtt_rig import *; from edge.mqtt.telemetry import Telemetry; import time;"
        "loop = ControlLoop();"
        f"t = Telemetry(settings({broker.port}), loop.ask, loop.post, MemoryOutbox); time.sleep(60)"
    )
    with Listener(broker.port) as listener:
        process = subprocess.Popen([sys.executable, "-c", program])
        try:
            wait_for(lambda: listener.payloads(AVAILABILITY) == [b"online"])
        finally:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        wait_for(lambda: listener.payloads(AVAILABILITY)[-1] == b"offline")


@pytest.mark.slow
def test_a_broker_that_is_down_at_the_start_is_waited_for(tmp_path):
    broker = Broker(tmp_path)
    with running(broker.port) as own:
        tick(own, record())
        wait_for(lambda: "can't be reached" in own.faults().get("telemetry.offline", ""))
        with broker, Listener(broker.port) as listener:
            wait_for(lambda: listener.objects(STATE))
            wait_for(lambda: not own.faults())


def test_online_and_discovery_come_again_after_every_reconnection(broker):
    with running(broker.port) as own:
        tick(own, record())
        wait_for(lambda: not own.faults())
        broker.kill()
        wait_for(own.faults)
        broker.start()
        with Listener(broker.port) as listener:
            wanted = {AVAILABILITY, DISCOVERY, STATE}
            wait_for(lambda: wanted <= {message.topic for message in listener.heard})
            wait_for(lambda: listener.payloads(AVAILABILITY)[-1] == b"online")


def test_home_assistant_is_told_everything_again_when_it_starts(broker):
    with Listener(broker.port) as listener, running(broker.port) as own:
        tick(own, record())
        wait_for(lambda: listener.payloads(STATE))
        listener.heard.clear()
        listener.send("homeassistant/status", "offline")
        listener.send("homeassistant/status", "online")

        def order() -> list[str]:  # a state sent before may still be on its way
            return [message.topic for message in listener.heard if message.topic in (DISCOVERY, STATE)]

        wait_for(lambda: order()[-2:] == [DISCOVERY, STATE])


def test_a_command_reaches_the_loop_and_is_answered_and_shown_at_once(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener, online(broker.port, loop):
        listener.send(f"{ROOT}/set/temperature", "28.5")
        wait_for(lambda: listener.objects(REPLY) == [{"command": "temperature", "ok": True}])
        assert loop.requests == [{"do": "set_reference", "reference_c": 28.5}]
        wait_for(lambda: listener.objects(STATE)[-1]["reference_c"] == 28.5)


def test_an_order_of_another_door_and_a_change_of_the_pins_are_shown_between_two_ticks(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop) as own:
        tick(own, record())
        wait_for(lambda: listener.objects(STATE) and listener.objects(STATE)[-1]["heater_duty"] == 0.35)
        loop.operation = replace(loop.operation, emergency_stop=True)
        loop.echo = Echo(0.0, False, 0.0, False, True, "emergency_stop", 101.0)
        own.show(loop.values())
        wait_for(lambda: listener.objects(STATE)[-1]["emergency_stop"] == 1)
        shown = listener.objects(STATE)[-1]
        assert (shown["heater_duty"], shown["fan_on"], shown["action"]) == (0.0, 0, "off")


def test_what_a_stop_that_is_not_on_disk_or_not_on_the_board_answers_reaches_the_sender(broker):
    loop = ControlLoop()
    hints = {"ok": False, "error": "in force now, but it will not survive a restart", "warning": "no link"}
    ask = loop.ask
    loop.ask = lambda request: ask(request) | (hints if request["do"] == "emergency_stop" else {})
    with Listener(broker.port) as listener, online(broker.port, loop):
        listener.send(f"{ROOT}/set/emergency_stop", "PRESS")
        wait_for(lambda: listener.objects(REPLY) == [{"command": "emergency_stop", **hints}])


def test_a_malformed_command_is_answered_with_its_error_and_an_event(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener, online(broker.port, loop):
        for payload in ("nan", b"\xff\x00", "x" * 5000):
            listener.send(f"{ROOT}/set/temperature", payload)
        wait_for(lambda: len(listener.objects(REPLY)) == 3)
        assert {answer["ok"] for answer in listener.objects(REPLY)} == {False}
        wait_for(lambda: len(listener.objects(EVENT)) == 3)
        assert listener.objects(EVENT)[0]["key"] == "mqtt.bad_command"
        assert loop.requests == []


def test_what_the_loop_refuses_is_answered_with_its_reason(broker):
    loop = ControlLoop()
    loop.ask = lambda request: {"ok": False, "error": "still too hot"}
    with Listener(broker.port) as listener, online(broker.port, loop):
        listener.send(f"{ROOT}/set/clear_trip", "PRESS")
        wait_for(
            lambda: (
                listener.objects(REPLY) == [{"command": "clear_trip", "ok": False, "error": "still too hot"}]
            )
        )


def test_a_retained_command_never_acts(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener:
        listener.send(f"{ROOT}/set/mode", "off", retain=True)
        with online(broker.port, loop):
            # The broker hands the retained message over before this later one.
            listener.send(f"{ROOT}/set/mode", "heat")
            wait_for(lambda: listener.objects(REPLY))
            assert loop.requests == [{"do": "set_mode", "mode": "heat"}]


def test_a_command_given_while_the_rig_was_away_never_acts(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener:
        with online(broker.port, loop):
            pass
        listener.send(f"{ROOT}/set/mode", "off")
        with online(broker.port, loop):
            listener.send(f"{ROOT}/set/mode", "heat")
            wait_for(lambda: listener.objects(REPLY))
            assert loop.requests == [{"do": "set_mode", "mode": "heat"}]


def test_events_of_a_tick_are_published_one_by_one(broker):
    events = tuple(Event(f"test.{n}", Severity.ALARM, "too hot", 0.0, 1.7e9) for n in range(3))
    with Listener(broker.port) as listener, running(broker.port) as own:
        tick(own, record(events=events))
        wait_for(lambda: len(listener.objects(EVENT)) == 3)
        assert [event["key"] for event in listener.objects(EVENT)] == ["test.0", "test.1", "test.2"]


def test_ticks_that_were_late_or_skipped_are_counted(broker):
    with Listener(broker.port) as listener, online(broker.port) as own:
        tick(own, record(late_s=6.0))  # of a step of 60 s: on the limit
        tick(own, record(late_s=6.1, ticks_skipped=2))
        tick(own, record(ticks_skipped=1))
        wait_for(lambda: listener.objects(STATE) and listener.objects(STATE)[-1]["ticks_skipped"] == 3)
        assert listener.objects(STATE)[-1]["ticks_late"] == 1


def test_a_resend_command_fills_the_outbox_again(broker):
    outbox, loop = MemoryOutbox(3), ControlLoop()
    loop.resend = outbox.resend
    with Listener(broker.port) as listener, running(broker.port, loop, outbox) as own:
        wait_for(lambda: not outbox.rows)
        listener.send(f"{ROOT}/set/resend", json.dumps({"first_seq": 2, "last_seq": 3}))
        span = {"first_seq": 2, "last_seq": 3}
        wait_for(lambda: listener.objects(REPLY) == [{"command": "resend", "ok": True, "queued": 2, **span}])
        wait_for(lambda: [row["seq"] for row in listener.objects(HISTORY)] == [1, 2, 3, 2, 3])
        assert not own.faults()


def test_a_slow_loop_holds_up_neither_the_network_nor_the_control_thread(broker):
    loop = ControlLoop()
    with Listener(broker.port) as listener, running(broker.port, loop, MemoryOutbox(10)) as own:
        tick(own, record())
        wait_for(lambda: len(listener.objects(HISTORY)) == 10)
        wait_for(lambda: listener.payloads(STATE))
        assert loop.requests == []  # nothing of a tick is asked for


def test_a_bug_is_told_and_takes_neither_commands_nor_the_outbox_away(broker):
    loop, outbox = ControlLoop(), MemoryOutbox()
    with Listener(broker.port) as listener, running(broker.port, loop, outbox) as own:
        own.show(replace(loop.values(), record=record(readings=None)))
        wait_for(lambda: "AttributeError" in str(own.faults()))
        listener.send(f"{ROOT}/set/emergency_stop", "PRESS")
        wait_for(lambda: listener.objects(REPLY) == [{"command": "emergency_stop", "ok": True}])
        assert loop.operation.emergency_stop
        outbox.resend(1, 3)
        wait_for(lambda: outbox.depth() == 0)


def test_an_outbox_that_cannot_be_read_is_told_and_tried_again(broker):
    outbox = MemoryOutbox(3)
    pending = outbox.pending

    def locked(limit):
        raise sqlite3.OperationalError("database is locked")

    outbox.pending = locked
    with running(broker.port, outbox=outbox) as own:
        wait_for(lambda: "database is locked" in str(own.faults()))
        outbox.pending = pending
        wait_for(lambda: not own.faults())
        wait_for(lambda: outbox.depth() == 0)


def test_remove_takes_everything_retained_away(broker):
    with running(broker.port) as own:
        tick(own, record())
        wait_for(lambda: not own.faults())
    telemetry.remove(settings(broker.port))
    with Listener(broker.port) as listener:
        listener.send("end", "")
        wait_for(lambda: listener.heard and listener.heard[-1].topic == "end")
        assert [message.topic for message in listener.heard] == ["end"]


def test_remove_says_when_there_is_no_broker(tmp_path):
    with pytest.raises(RequestError, match="took no message"):
        telemetry.remove(settings(Broker(tmp_path).port), timeout_s=0.2)


@pytest.mark.parametrize("host", ["", "a..b", "x" * 70])
def test_a_host_that_is_no_name_is_refused_at_the_start(host):
    with pytest.raises(ConfigError, match=r"^host: .* (is not a host name|does not match)"):
        connection.make_client(settings(host=host).mqtt)


def test_the_command_takes_a_rig_off_the_broker(broker, tmp_path, capsys):
    config = tmp_path / "edge.yaml"
    config.write_text(
        f"control_socket: {{path: {tmp_path}/control.sock}}\n"
        f"mqtt: {{enabled: true, host: 127.0.0.1, port: {broker.port}, rig: rig-1}}\n"
    )
    with Listener(broker.port, "homeassistant/#") as listener:
        listener.send("homeassistant/device/rig-1/config", "{}", retain=True)
        assert main(["forget-discovery", "--config", str(config)]) == 0
        wait_for(lambda: listener.payloads("homeassistant/device/rig-1/config") == [b"{}", b""])
    assert "rig-1: taken off" in capsys.readouterr().out


def test_the_command_refuses_while_the_daemon_runs(tmp_path, capsys):
    config, socket = tmp_path / "edge.yaml", tmp_path / "control.sock"
    config.write_text(f"control_socket: {{path: {socket}}}\n")
    with closing(ControlSocket(socket, lambda request: {"ok": True}, lambda *_: None)):
        assert main(["forget-discovery", "--config", str(config)]) == 2
    assert "stop it first" in capsys.readouterr().err


@pytest.fixture
def evicting():
    """Return a function that starts a broker on which another client takes each session over; its port."""
    connack, reason = bytes((0x20, 3, 0, 0, 0)), bytes((0xE0, 2, connection.TAKEN_OVER, 0))

    def serve(server, last):
        with contextlib.suppress(OSError):
            while True:
                session, _ = server.accept()
                with session:
                    session.recv(1000)
                    session.sendall(connack + last)
                    session.shutdown(socket.SHUT_WR)
                    while session.recv(1000):  # a reset would take the answer away
                        pass

    with ExitStack() as stack:

        def start(gives_reason):
            server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
            stack.callback(server.shutdown, socket.SHUT_RDWR)
            last = reason if gives_reason else b""
            threading.Thread(target=serve, args=(server, last), daemon=True).start()
            return server.getsockname()[1]

        yield start


@pytest.mark.parametrize("gives_reason", [True, False])  # mosquitto 2.0.11 gives none
def test_a_rig_whose_name_another_one_uses_says_so_and_tries_slowly(evicting, gives_reason):
    slow = connection.TAKEN_OVER_RETRY_S
    with running(evicting(gives_reason)) as own:
        clients = [own._client, *(lane._client for lane in own._lanes)]
        wait_for(lambda: [client._reconnect_min_delay for client in clients] == [slow] * len(clients))
        assert slow >= 60
        # Not offline as well, which would come and go with every try.
        ((key, detail),) = own.faults().items()
        assert key == "telemetry.name_taken" and "the name is rig-1" in detail
        assert ("reports" if gives_reason else "after 0.0 s, the broker gives no reason") in detail
        own._on_connect(own._client, None, None, ReasonCode(PacketTypes.CONNACK, "Success"), None)
        own._on_disconnect(own._client, None, None, ReasonCode(PacketTypes.DISCONNECT, "Server busy"), None)
        assert own._client._reconnect_min_delay == connection.RECONNECT_MIN_S  # an ordinary loss
        assert "telemetry.name_taken" in own.faults()
        own._name._evicted_s = float("-inf")  # long ago
        assert own.faults() == {"telemetry.offline": "disconnected: Server busy"}


def lose(watch, client, ages, code="Unspecified error", between=lambda: None):
    """Sessions in succession, a second apart; the cause after the last one."""
    now_s = 1000.0
    for age_s in ages:
        between()
        watch.begin(now_s)
        now_s += age_s
        watch.end(client, ReasonCode(PacketTypes.DISCONNECT, code), now_s)
        now_s += 1.0
    return watch.cause(now_s)


def test_only_young_sessions_in_succession_that_end_without_a_reason_raise_the_suspicion():
    client, watch = connection.make_client(settings().mqtt), connection.NameWatch()
    for ages in ([1.0, 1.0], [1.0, 1.0, 5.1, 1.0, 1.0], [59.9] * 9, [65.1] * 9, [600.0] * 9):
        assert lose(connection.NameWatch(), client, ages) == ""
    assert lose(connection.NameWatch(), client, [1.0] * 9, "Server shutting down") == ""  # a restart
    assert lose(watch, client, [1.0] * 9, between=watch.fail) == ""  # the network or a broker that is down
    unanswered = connection.NameWatch()  # a broker behind a proxy: each second attempt gets no CONNACK
    lost = ReasonCode(PacketTypes.DISCONNECT, "Unspecified error")
    assert lose(unanswered, client, [1.0] * 9, between=lambda: unanswered.end(client, lost, 1000.0)) == ""
    assert client._reconnect_min_delay == connection.RECONNECT_MIN_S
    assert "sessions end after 5.0 s" in lose(connection.NameWatch(), client, [1.0, 1.0, 5.0])
    assert client._reconnect_min_delay == connection.TAKEN_OVER_RETRY_S


def test_with_slow_retries_a_longer_session_is_an_eviction_too_until_the_broker_is_away():
    client, watch = connection.make_client(settings().mqtt), connection.NameWatch()
    assert "after 1.0 s" in lose(watch, client, [1.0, 1.0, 1.0, 60.0, 120.0])
    watch.fail()
    assert lose(watch, client, [1.0, 1.0]) == ""


def test_a_rig_that_another_one_evicts_by_slow_retries_suspects_it_too():
    client = connection.make_client(settings().mqtt)
    # The first rig of two to suspect tries slowly; seen with mosquitto 2.0.11: only that one gave way.
    assert "after 60.5 s" in lose(connection.NameWatch(), client, [1.0, 1.0, 60.5])
    assert client._reconnect_min_delay == connection.TAKEN_OVER_RETRY_S


def test_forgetting_a_rig_evicts_no_daemon(broker):
    with online(broker.port) as own:
        remove(settings(broker.port))
        assert not own.faults()
