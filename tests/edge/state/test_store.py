"""edge/state/store.py: one list of all that survives a restart, and files of earlier software are read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.config.loading import default
from edge.config.settings import BundleSettings, HistorySettings, Settings
from edge.core.messages import Command
from edge.formats.atomic_file import read_document, write_document
from edge.safety.memory import Dose
from edge.state.store import (
    BOARD_ID,
    DRIFT,
    LLM_BUDGET,
    SKILL,
    STANDING,
    STORED,
    SURVIVORS,
    StoredValue,
    restore,
)
from edge.tick.orders import FanMode, Mode
from tests.support.daemon_process import DaemonProcess
from tests.support.virtual_board import virtual_board

WRITTEN = Path(__file__).parent / "written_by_8465879"  # as that commit saved them


def settings(folder: Path) -> Settings:
    return replace(
        default(),
        state_file=str(folder / "state.json"),
        bundle=BundleSettings(path=str(folder / "bundles")),
        history=HistorySettings(path=str(folder / "history.db")),
    )


def test_without_a_state_file_the_configured_controller_runs(tmp_path: Path) -> None:
    standing = restore(STANDING, settings(tmp_path))
    assert standing.operation.controller == default().control.controller
    assert not standing.operation.emergency_stop
    assert standing.broken == ""


def test_orders_and_latched_trips_of_an_installed_daemon_are_read_after_an_upgrade() -> None:
    standing = restore(STANDING, settings(WRITTEN))
    orders = standing.operation
    assert standing.broken == ""
    assert (orders.controller, orders.mode, orders.fan_mode) == ("MPC-P", Mode.HEAT, FanMode.OFF)
    assert (orders.reference_c, orders.emergency_stop) == (26.5, True)
    assert orders.manual == Command(heater_duty=0.35, fan_on=True, led=0.5)
    assert orders.maintenance_until_utc == 1750003600.25
    assert orders.steering is not None and orders.steering.words == "nachts kühler"
    assert orders.before is not None and orders.before.reference_c == 25.0
    assert standing.memory.trips == ("over_temperature", "fan_no_effect")
    assert standing.memory.doses == (Dose(None, 1750000000.0, 2.0), Dose(None, 1750000600.5, 1.25))


def test_the_other_states_of_an_installed_daemon_are_read_after_an_upgrade() -> None:
    skill, drift = restore(SKILL, settings(WRITTEN)), restore(DRIFT, settings(WRITTEN))
    assert skill.pairs["arx", 60, "pbm"].scored == 1440
    assert skill.widths["ham", 3].half_width_k == 0.75
    assert drift is not None and drift.twin_sha256 == "ab" * 32
    assert drift.since_utc == 1750000123.0 and np.isfinite(drift.sums).all()
    assert restore(LLM_BUDGET, settings(WRITTEN)).tokens == 1234


@pytest.mark.parametrize("stored", [each for each in STORED if each is not BOARD_ID])
def test_a_state_is_saved_again_to_the_same_bytes(stored: StoredValue, tmp_path: Path) -> None:
    path = stored.place(settings(WRITTEN))
    write_document(tmp_path / path.name, stored.encode(stored.decode(read_document(path))))
    assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_no_two_survivors_share_a_file_and_each_says_all(tmp_path: Path) -> None:
    places = [survivor.place(settings(tmp_path)) for survivor in SURVIVORS]
    assert len(set(places)) == len(places)
    assert all(survivor.owner and survivor.valid for survivor in SURVIVORS)


@pytest.mark.slow
def test_a_daemon_leaves_no_file_that_the_list_does_not_name(tmp_path: Path) -> None:
    with virtual_board(tmp_path, "--real-time"), DaemonProcess(tmp_path) as daemon:
        daemon.wait_ticks(2)
        daemon.ask("set_reference", reference_c=25.0)
        own = {path.name for path in tmp_path.iterdir() if path.suffix == ".json"} - {"state.json"}
        daemon.stop()
    saved = {path.name for path in tmp_path.iterdir() if path.suffix == ".json"}
    assert {"state.json", "skill.json"} <= saved
    assert saved - own <= {survivor.place(settings(tmp_path)).name for survivor in SURVIVORS}
