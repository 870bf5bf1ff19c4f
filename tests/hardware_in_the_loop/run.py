"""Runs the daemon against a virtual board in lock-step and keeps all that can be known of it afterwards."""

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from edge.board.sim_clock import START_UTC
from edge.board.virtual_rig import BOARD
from edge.config import loading as config
from edge.core.messages import TickRecord
from tests.support.virtual_board import CORES
from tests.support.watched_clock import Look, TimedRequest, WatchedClock
from training.lab import Lab

VALVE_FLOW_KG_S, TANK_KG = 0.008, 2.0  # chamber.yaml: tank
# Dry soil and a pulse at every tick, as long as the day's dose lasts: each fault meets an open valve.
DRY_SOIL = {"soil": {"water_start": 0.45}, "sensors": {"soil_noise": 0.0, "tank_noise": 0.0}}
SETTINGS = {
    "control": {"controller": "MPC"},
    "reference": {"kind": "constant", "reference_c": 36.0},  # so hot that the heater is on for 20 minutes
    "watering": {"enabled": True, "threshold": 0.75, "pulse_s": 2.0, "soak_s": 60.0, "daily_max_s": 60.0},
}


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """A row of the history's table `events`."""

    time_s: float
    key: str
    severity: str
    text: str


@dataclass(frozen=True, slots=True)
class ScenarioRun:
    """The truth, the records and the events of a run."""

    looks: Sequence[Look]
    records: Sequence[TickRecord]
    events: Sequence[StoredEvent]  # as the history has them
    replies: Sequence[Mapping[str, Any]]  # to the orders
    truth: Mapping[str, Any]  # after the daemon has ended

    def first(self, key: str) -> StoredEvent | None:
        """The first event of one key."""
        return next((event for event in self.events if event.key == key), None)

    def told(self, severity: str | None = None) -> set[str]:
        """Keys of the events that were told."""
        return {event.key for event in self.events if severity in (None, event.severity)}

    def hottest_c(self, from_s: float = 0.0) -> float:
        """Hottest true air [°C]."""
        return max(look.temp_air_c for look in self.looks if look.time_s >= from_s)

    def water_given_s(self) -> float:
        """Valve time by the water that is missing in the tank [s]."""
        return (self.looks[0].tank_level - self.truth["chamber"]["tank_level"]) * TANK_KG / VALVE_FLOW_KG_S

    def water_ordered_s(self) -> float:
        """Valve time of all pulses that were sent [s]."""
        return sum(record.sent.valve_pulse_s for record in self.records)


def run(
    folder: Path,
    end_s: float,
    *,
    core: str = "python",
    seed: int = 1,
    faults: Sequence[Mapping[str, Any]] = (),
    orders: Sequence[TimedRequest] = (),
    settings: Mapping[str, Any] | None = None,
    board: Sequence[str] = (),
    chamber: Mapping[str, Any] | None = None,
    look_s: float = 1.0,
) -> ScenarioRun:
    """One daemon's life of `end_s` simulated seconds."""
    folder.mkdir(parents=True, exist_ok=True)
    with Lab(
        _settings(folder, settings or {}),
        seed=seed,
        folder=folder,
        chamber=_merged(DRY_SOIL, chamber or {}),
        faults=faults,
        options=("--core", CORES.get(core, core), *board),
        clock=lambda sim: WatchedClock(sim, folder / "daemon.sock", orders, look_s),
    ) as lab:
        lab.run(until_s=end_s)
        truth = lab.board.truth()
    clock = lab.clock
    return ScenarioRun(clock.looks, lab.history, _events(folder / "history.db"), clock.replies, truth)


def _settings(folder: Path, changes: Mapping[str, Any]) -> Any:
    places = {
        "state_file": str(folder / "state.json"),
        "control_socket": {"path": str(folder / "daemon.sock")},
        "history": {"path": str(folder / "history.db")},
        "board": {"port": str(folder / BOARD)},
        "box": {"heater_w": 100.0},
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
    }
    return config.parse(yaml.safe_dump(_merged(_merged(SETTINGS, places), changes)), "scenario")


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = _merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


def _events(history: Path) -> list[StoredEvent]:
    with closing(sqlite3.connect(f"file:{history}?mode=ro", uri=True)) as connection:
        rows = connection.execute("SELECT utc, key, severity, text FROM events ORDER BY seq, number")
        return [StoredEvent(utc - START_UTC, key, severity, text) for utc, key, severity, text in rows]
