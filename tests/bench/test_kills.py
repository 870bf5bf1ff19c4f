"""bench/kills.py, short: after an acknowledged stop and a kill -9 no actuator moves until the release."""

from pathlib import Path

import pytest

from bench import kills
from bench.kills import PINS, KillPlan, one_kill, rig_in, run
from tests.support.broker import needs_mosquitto, wait_for

AT_ONCE = KillPlan("emergency_stop", "socket", 30.0, 0.0, 0.0, 20.0, False, None)


@needs_mosquitto
def test_no_actuator_moves_after_an_acknowledged_stop_and_a_kill():
    assert run(3, seed=4, core="python") == 0


def test_a_stop_that_is_lost_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "MOSQUITTO", None)
    with rig_in(tmp_path, "python") as rig:
        rig.restart()
        rig.order("socket", kills.MOVING)
        wait_for(lambda: not kills._resting(rig, 0.0))
        kill = rig.kill

        def kill_and_forget() -> None:
            kill()
            (tmp_path / "state.json").write_text(standing)

        standing = (tmp_path / "state.json").read_text()
        rig.kill = kill_and_forget  # type: ignore[method-assign]
        found = " ".join(one_kill(rig, AT_ONCE))
    assert all(f"{pin} on" in found for pin in PINS if pin != "valve")
    assert "does not know" in found
