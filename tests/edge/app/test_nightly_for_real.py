"""The diagnosis at night with the real command: a history, a twin that lacks something, and what is told."""

import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from history_records import HandClock, History, tick
from loop_rig import FakeClock

from edge.app.nightly_diagnosis import NightlyDiagnosis, Places
from edge.config.settings import DriftSettings
from edge.core.messages import Command, Echo, Reading, ReadingQuality
from edge.storage import Storage
from edge.twin.twin_file import write_twin_file
from tests.support.broker import wait_for
from tests.support.simulated_runs import BOX, simulate, twin_file

pytestmark = pytest.mark.slow

NIGHT = datetime(2026, 7, 1, 3, 0, tzinfo=UTC).timestamp()
ROWS = 240
PATIENCE_S = 120.0


def recorded_till_now(history: Path) -> None:
    """A box whose heater is slow, as the daemon has recorded it till a minute ago."""
    box = simulate({**BOX, "heater_lag": {"tau_h": 240.0}}, 1, ROWS).columns
    storage = Storage(History.at(history, queue_ticks=ROWS), HandClock())
    storage.open()
    now = time.time()
    for k in range(ROWS):
        readings = {
            name: Reading(name, float(box[f"{name}_c"][k]), 60.0 * k, ReadingQuality.GOOD)
            for name in ("temp_air", "temp_ambient")
        }
        duty, fan_on = float(box["heater_duty"][k]), bool(box["fan_on"][k])
        command = Command(duty, fan_on, 0.0)
        echo = Echo(duty, fan_on, 0.0, False, False, "", 60.0 * k)
        utc = now - 60.0 * (ROWS - k)
        storage.write(tick(k + 1, utc=utc, readings=readings, wanted=command, sent=command, echo=echo))
    assert storage.close(20.0)


def test_a_night_with_the_real_command(tmp_path: Path) -> None:
    recorded_till_now(tmp_path / "history.db")
    write_twin_file(twin_file(), tmp_path / "twin.yaml")
    settings = DriftSettings(
        reports=str(tmp_path / "reports"), diagnose="always", adopt="never", diagnose_since_d=2.0
    )
    places = Places(tmp_path / "history.db", lambda: tmp_path / "twin.yaml")
    night = NightlyDiagnosis(settings, places, FakeClock(), UTC)
    told: dict[str, str] = {}

    def ended() -> bool:
        told.update({event.key: event.text for event in night.events_pending()})
        return bool(told.keys() & {"diagnosis.done", "diagnosis.failed"})

    try:
        night.write(tick(1, utc=NIGHT - 60.0))
        night.write(tick(2, utc=NIGHT))
        wait_for(ended, "the end of a diagnosis", PATIENCE_S)
    finally:
        night.close()
    report = tmp_path / "reports" / "2026-07-01_0300"
    assert told.get("diagnosis.done") == f"the diagnosis names heater_lag; report: {report}", told
    assert (report / "report.html").stat().st_size > 10_000
