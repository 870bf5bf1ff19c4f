"""edge/core: events that repeat are counted and do not fill a tick, and a signal is one row of names.py."""

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from loop_rig import FakeClock, LoopRig

from edge.board.board import Board
from edge.board.serial_port import PortGone
from edge.config.settings import CalibrationSettings
from edge.core import names
from edge.core.event_log import EventLog
from edge.core.messages import Event, Severity
from edge.core.names import SIGNALS, Signal
from edge.formats.run_file import KNOWN
from edge.mqtt import discovery
from edge.storage.file import connect
from edge.tick.loop import ORDERS_TOLD
from firmware_protocol.messages import LAYOUTS, SensorReport


@pytest.fixture
def rig() -> Iterator[LoopRig]:
    parts = LoopRig()
    yield parts
    parts.close()


def event(key: str, text: str = "it happened", severity: Severity = Severity.INFO) -> Event:
    return Event(key, severity, text, 0.0, 0.0)


def told(events: list[Event]) -> Counter[str]:
    """How often each key happened, by what the events say."""
    times: Counter[str] = Counter()
    for each in events:
        found = re.match(r"(\d+) more times", each.text)
        times[each.key] += int(found[1]) if found else 1
    return times


@given(st.lists(st.sampled_from("abc"), max_size=60), st.integers(1, 5))
def test_every_event_is_told_or_counted_and_a_key_has_few(keys: list[str], whole: int) -> None:
    log = EventLog(whole)
    log.add(*(event(key) for key in keys))
    events = log.take()
    assert told(events) == Counter(keys)
    assert max(Counter(each.key for each in events).values(), default=0) <= whole + 1
    assert log.take() == []


def test_a_few_events_are_told_whole_and_in_order() -> None:
    log = EventLog()
    events = [event("a", "1"), event("b", "2"), event("a", "3")]
    log.add(*events)
    assert log.take() == events


def test_a_summary_has_the_last_text_and_the_gravest_severity() -> None:
    log = EventLog()
    grave = [Severity.INFO, Severity.ALARM, Severity.WARNING, Severity.INFO]
    log.add(*(event("a", str(number), severity) for number, severity in enumerate(grave)))
    assert log.take() == [event("a", "0"), event("a", "3 more times, the last one: 3", Severity.ALARM)]


class LoosePort:
    """A plug that makes contact for a moment each time."""

    bytes_out = bytes_in = 0

    def fileno(self) -> int:
        return -1

    def read(self) -> bytes:
        raise PortGone("no contact")

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


def test_a_plug_without_contact_makes_four_events_in_a_minute_and_not_a_hundred() -> None:
    clock = FakeClock()
    board = Board("/dev/loose", 115200, clock, 1, lambda path, baudrate: LoosePort())
    board.serve(clock.now() + 60.0)
    events = board.take_events()
    assert told(events)["board.unplugged"] >= 50
    assert told(events)["board.port_open"] >= 50
    assert len(events) == 4


def test_a_thousand_orders_between_two_ticks_are_counted(rig: LoopRig) -> None:
    rig.tick()
    for number in range(1000):
        rig.inbox.post({"do": "set_reference", "reference_c": 20.0 + number % 7}, lambda reply: None)
        rig.loop._serve_and_answer(rig.clock.now_s)
    events = [each for each in rig.tick().events if each.key == "operator.order"]
    assert len(events) == ORDERS_TOLD + 1
    assert told(events)["operator.order"] == 1000


LEAF = Signal("temp_leaf", "°C", "temp_leaf_c", -20.0, 80.0, "tCan", "Leaf temperature", "temperature", 1)


def test_each_signal_can_be_calibrated_and_travels_on_the_wire() -> None:
    assert [field.name for field in fields(CalibrationSettings)] == list(SIGNALS)
    wire = {field.name for field in LAYOUTS[SensorReport].fields}
    assert {signal.key for signal in SIGNALS.values()} | {f"{name}_quality" for name in SIGNALS} <= wire
    assert {signal.key for signal in SIGNALS.values()} <= set(KNOWN)


def test_a_signal_is_shown_in_home_assistant_by_its_row() -> None:
    shown = discovery._signal(LEAF)
    assert shown["name"] == "Leaf temperature"
    assert shown["unit_of_measurement"] == "°C"
    assert shown["device_class"] == "temperature"
    share = discovery._signal(Signal("leaf_wetness", "1", "leaf_wetness", 0.0, 1.0, "", "Leaf wetness"))
    assert share["unit_of_measurement"] == "%"
    assert "device_class" not in share


def test_a_history_that_is_older_than_a_signal_gets_its_column(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "history.db"
    old = connect(path, 1.0)
    old.execute("INSERT INTO readings VALUES (1, 'temp_air_c', 21.5, 'good')")
    old.execute("INSERT INTO ticks (seq, utc, step_s) VALUES (1, 0.0, 60.0)")
    old.close()
    monkeypatch.setitem(names.SIGNALS, "temp_leaf", LEAF)
    new = connect(path, 1.0)
    new.execute("INSERT INTO readings VALUES (1, 'temp_leaf_c', 23.0, 'good')")
    assert new.execute("SELECT temp_air_c, temp_leaf_c FROM v_ticks").fetchall() == [(21.5, 23.0)]
    new.close()
    sqlite3.connect(path).close()
