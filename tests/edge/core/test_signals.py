"""A signal is one row of edge/core/names.py: every room that lists signals reads it there."""

import sqlite3
from dataclasses import fields
from pathlib import Path

import pytest

from edge.config.settings import CalibrationSettings
from edge.core import names
from edge.core.names import SIGNALS, Signal
from edge.formats.run_file import KNOWN
from edge.mqtt import discovery
from edge.storage.file import connect
from firmware_protocol.messages import LAYOUTS, SensorReport

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
