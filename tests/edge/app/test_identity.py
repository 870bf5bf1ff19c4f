"""A daemon's identity: the board that it drives, its entry among the running rigs, files that are its own."""

import json
from contextlib import closing
from pathlib import Path

import pytest

from edge.app.daemon import Daemon
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.config import loading
from edge.config.settings import Settings
from edge.core.messages import TickRecord
from edge.tick.status import status_json

RULES = "control: {controller: rules}\nreference: {kind: constant, reference_c: 30}\ndrift: {enabled: false}"


def settings_of(folder: Path) -> Settings:
    return settings_in(folder, loading.parse(RULES))


def three_ticks(folder: Path) -> tuple[list[TickRecord], dict[str, object]]:
    """Run a daemon at a virtual board; return its ticks, and its status after the last one."""
    records: list[TickRecord] = []
    with (
        virtual_rig(folder, 1) as rig,
        closing(SimClock(rig.control)) as clock,
        Daemon(settings_of(folder), clock, records.append, stop_at_s=170.0) as daemon,
    ):
        daemon.run()
        return records, status_json(daemon.status())


def keys(records: list[TickRecord]) -> list[str]:
    return [event.key for record in records for event in record.events]


def test_a_rig_pins_the_board_that_it_sees_first_and_drives_no_other(tmp_path: Path) -> None:
    pin = tmp_path / "board.json"
    records, status = three_ticks(tmp_path)
    assert json.loads(pin.read_text()) == {"board_id": 1}
    assert records[-1].sent.heater_duty > 0.0 and "board.pinned" in keys(records)
    pin.write_text(json.dumps({"board_id": 0x7777}))
    records, status = three_ticks(tmp_path)
    assert [record.sent.heater_duty for record in records] == [0.0] * 3
    assert "board.foreign" in keys(records) and "board.link_down" not in keys(records)
    assert status["foreign_board"] == f"board 1 answers, board {0x7777} is pinned"
    assert status["conditions"] == {"board.foreign": "another board is at the port"}
    assert json.loads(pin.read_text()) == {"board_id": 0x7777}


@pytest.mark.parametrize("broken", ["{", '{"board_id": "1"}', "{}", "[]"])
def test_a_rig_whose_pin_is_lost_says_that_it_pins_again(tmp_path: Path, broken: str) -> None:
    (tmp_path / "board.json").write_text(broken)
    records, _ = three_ticks(tmp_path)
    assert "board.pinned" in keys(records) and records[-1].link_up
