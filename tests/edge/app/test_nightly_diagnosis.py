"""app/nightly_diagnosis.py: when it is due, what is called, what is told. `greenhouse` is a small script."""

import os
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from datetime import time as clock_time
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from loop_rig import FakeClock

from bench.support.broker import wait_for
from bench.support.mqtt_rig import record
from edge.app.nightly_diagnosis import (
    LOG,
    REPORTS_KEPT,
    ROWS_MAX,
    NightlyDiagnosis,
    Places,
    is_due,
    lowest_priority,
    prune,
)
from edge.config.settings import DriftSettings
from edge.core.messages import Drift, DriftState, Event

NIGHT = datetime(2026, 7, 1, 3, 0, tzinfo=UTC).timestamp()
DISAGREES = Drift(DriftState.DISAGREES)
FAKE = """
import json, os, sys, time
from pathlib import Path
folder = Path({folder!r})
words = sys.argv[1:]
with (folder / "calls").open("a") as calls:
    print(os.nice(0), *words, file=calls)
{body}
"""
NAMED = """
if words[1] == "diagnose":
    out = Path(words[words.index("--out") + 1])
    found = {"verdict": "named", "effects": [{"name": "wall_loss"}], "twin_after": "twin.yaml"}
    (out / "diagnosis.json").write_text(json.dumps(found))
else:
    print("bundle 1.0-twin is installed")
"""


class Night:
    """A nightly diagnosis whose ticks a test hands in, and what it says."""

    def __init__(self, folder: Path, body: str = NAMED, twin: Path | None = Path("twin.yaml"),
                 on_trial: bool = False, requests: Path | None = None, **settings):  # fmt: skip
        self.folder = folder
        program = folder / "greenhouse.py"
        program.write_text(FAKE.format(folder=str(folder), body=body))
        given = DriftSettings(reports=str(folder / "reports"), **{"diagnose": "disagrees", **settings})
        config = folder / "edge.yaml"
        places = Places(folder / "history.db", lambda: twin, config, lambda: on_trial, requests)
        self.diagnosis = NightlyDiagnosis(given, places, FakeClock(), UTC, (sys.executable, str(program)))
        self.events: list[Event] = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.diagnosis.close()

    def tick(self, utc: float, drift: Drift | None = DISAGREES) -> None:
        self.diagnosis.write(replace(record(), utc=utc, drift=drift))

    def strike_three(self, drift: Drift | None = DISAGREES) -> None:
        self.tick(NIGHT - 60.0, drift)
        self.tick(NIGHT, drift)

    def told(self, key: str) -> str:
        """The text of the event, once it is there."""
        wait_for(lambda: self._take() or key in self.keys, f"{key} in {self.keys}")
        return next(event.text for event in self.events if event.key == key)

    @property
    def keys(self) -> list[str]:
        return [event.key for event in self.events]

    @property
    def calls(self) -> list[str]:
        path = self.folder / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def _take(self) -> None:
        self.events += self.diagnosis.events_pending()


# when


@pytest.mark.parametrize(
    ("before", "now", "due"),
    [
        (-60.0, 0.0, True),
        (-60.0, -1.0, False),
        (0.0, 60.0, False),  # it was due a tick ago
        (-1.0, 59.0, True),
        (-60.0, 3599.0, True),  # the host slept for an hour
        (-60.0, 3600.0, False),
        (-1e9, 1800.0, True),  # the clock was set
        (-1e9, 5 * 3600.0, False),
        (60.0, 0.0, False),  # the clock went back
        (-86400.0, 0.0, True),
    ],
)
def test_it_is_due_where_the_hour_lies_between_two_ticks(before, now, due):
    assert is_due(NIGHT + before, NIGHT + now, clock_time(3, 0), UTC) is due


def test_the_hour_is_local():
    oslo = ZoneInfo("Europe/Oslo")  # two hours ahead of UTC in July
    at = clock_time(3, 0)
    assert not is_due(NIGHT - 60.0, NIGHT, at, oslo)
    assert is_due(NIGHT - 7260.0, NIGHT - 7200.0, at, oslo)


@pytest.mark.parametrize(
    ("diagnose", "drift", "called"),
    [
        ("disagrees", DISAGREES, True),
        ("disagrees", Drift(DriftState.AGREES), False),
        ("disagrees", Drift(), False),
        ("disagrees", None, False),
        ("always", None, True),
    ],
)
def test_it_runs_where_it_is_asked_for(tmp_path, diagnose, drift, called):
    with Night(tmp_path, diagnose=diagnose) as night:
        night.strike_three(drift)
        if called:
            night.told("diagnosis.done")
    assert bool(night.calls) is called


# what


def test_it_reads_the_history_and_writes_a_report(tmp_path):
    with Night(tmp_path, diagnose_since_d=0.5, adopt="never") as night:
        night.strike_three()
        report = tmp_path / "reports" / "2026-07-01_0300"
        assert night.told("diagnosis.done") == f"the diagnosis names wall_loss; report: {report}"
    bounds = f"--since 0.5d --rows {ROWS_MAX}"
    words = f"twin diagnose --jobs 1 --history {tmp_path}/history.db {bounds} --twin twin.yaml"
    niceness, _, called = night.calls[0].partition(" ")
    assert called == f"{words} --out {report}"
    assert int(niceness) == 19
    assert len(night.calls) == 1  # nothing is adopted unasked
    assert night.keys == ["diagnosis.started", "diagnosis.done"]


@pytest.mark.parametrize(("adopt", "word"), [("shadow", "--shadow"), ("activate", "--activate")])
def test_what_it_found_goes_where_the_settings_say(tmp_path, adopt, word):
    with Night(tmp_path, adopt=adopt) as night:
        night.strike_three()
        assert night.told("diagnosis.adopted") == "bundle 1.0-twin is installed"
    assert night.calls[1].endswith(
        f"twin adopt {tmp_path}/reports/2026-07-01_0300 {word} --config {tmp_path}/edge.yaml"
    )


def test_a_trial_that_runs_is_not_ended_by_another_twin(tmp_path):
    with Night(tmp_path, adopt="activate", on_trial=True) as night:
        night.strike_three()
        assert "stays in" in night.told("diagnosis.kept")
    assert len(night.calls) == 1


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"verdict": "nothing_missing", "effects": []}, "nothing missing"),
        ({"verdict": "unknown", "depends_on": ["fan_on", "light"]}, "depends on fan_on, light"),
    ],
)
def test_where_it_names_nothing_nothing_is_adopted(tmp_path, found, words):
    body = f"out = Path(words[-1])\n(out / 'diagnosis.json').write_text(json.dumps({found!r}))"
    with Night(tmp_path, body, adopt="activate") as night:
        night.strike_three()
        assert words in night.told("diagnosis.done")
    assert len(night.calls) == 1


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("sys.exit('history: no run of an hour')", "ended with 1: history: no run of an hour"),
        ("", "diagnosis.json"),
        ("(Path(words[-1]) / 'diagnosis.json').write_text('{')", "diagnosis.json: not JSON"),
        (
            "os.mkfifo(Path(words[-1]) / 'diagnosis.json')",
            "diagnosis.json: cannot be read: not a regular file",
        ),
        ("os.kill(os.getpid(), 9)", "ended with -9: it needed more memory than it may have"),
        ("bytearray(1 << 30)", "it needed more memory than it may have; MemoryError"),
    ],
)
def test_a_diagnosis_that_fails_is_told_and_the_next_night_tries_again(tmp_path, body, words):
    with Night(tmp_path, body) as night:
        night.strike_three()
        assert words in night.told("diagnosis.failed")
        wait_for(lambda: not night.diagnosis._busy)
        night.tick(NIGHT + 86400.0 - 60.0)
        night.tick(NIGHT + 86400.0)
        wait_for(lambda: len(night.calls) == 2)


def test_without_a_twin_nothing_is_called(tmp_path):
    with Night(tmp_path, twin=None) as night:
        night.strike_three()
        assert "no twin runs" in night.told("diagnosis.failed")
    assert night.calls == []


def test_one_at_a_time_and_none_after_its_time(tmp_path, monkeypatch):
    with Night(tmp_path, "time.sleep(60)", diagnose_max_min=1.0) as night:
        monkeypatch.setattr(night.diagnosis, "_settings", Limited(night.diagnosis._settings))
        night.strike_three()
        wait_for(lambda: night.calls)
        night.strike_three()
        assert "took longer than 0.005 min" in night.told("diagnosis.failed")
    assert len(night.calls) == 1


class Limited:
    """The settings with less patience than a setting may have: 0.3 s."""

    diagnose_max_min = 0.005

    def __init__(self, settings: DriftSettings) -> None:
        self._settings = settings

    def __getattr__(self, name: str):
        return getattr(self._settings, name)


def test_it_ends_with_the_daemon(tmp_path):
    body = "(folder / 'pid').write_text(str(os.getpid()))\ntime.sleep(60)"
    with Night(tmp_path, body) as night:
        night.strike_three()
        wait_for(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
        begun = time.monotonic()
    assert time.monotonic() - begun < 5.0
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_old_reports_are_deleted_and_other_files_are_not(tmp_path):
    first = datetime(2026, 1, 1, tzinfo=UTC)
    for day in range(REPORTS_KEPT + 2):
        folder = tmp_path / (first + timedelta(days=day)).strftime("%Y-%m-%d_0300")
        folder.mkdir()
        (folder / LOG).touch()
    (tmp_path / "0000-mine").mkdir()
    prune(tmp_path)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert len(left) == REPORTS_KEPT + 1
    assert left[:2] == ["0000-mine", "2026-01-03_0300"]


def test_the_priority_is_the_lowest_that_this_machine_knows(monkeypatch):
    assert "nice" in lowest_priority()
    monkeypatch.setenv("PATH", "")
    assert lowest_priority() == ()
