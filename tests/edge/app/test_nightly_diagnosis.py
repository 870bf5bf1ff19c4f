"""edge/app/nightly_diagnosis.py: when it is due, what is called and told, and the unit that runs it."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from datetime import time as clock_time
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from loop_rig import FakeClock

from edge.app import nightly_diagnosis
from edge.app.nightly_diagnosis import (
    ANSWER,
    LATE,
    LOG,
    REPORTS_KEPT,
    REQUEST,
    ROWS_MAX,
    BackgroundFailure,
    NightlyDiagnosis,
    Places,
    ask,
    is_due,
    lowest_priority,
    prune,
    serve,
)
from edge.config.settings import DriftSettings
from edge.core.messages import Drift, DriftState, Event
from tests.support.broker import wait_for
from tests.support.mqtt_rig import record

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
    words = f"twin diagnose --history {tmp_path}/history.db {bounds} --twin twin.yaml"
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


# by order


def adopted(night: Night, **values: object) -> dict[str, object]:
    """The outcome of an order."""
    begun = night.diagnosis.answer({"do": "adopt", "by": "Ann (page)", **values})
    assert begun["ok"], begun
    wait_for(lambda: night.diagnosis.answer({"do": "adopt", "job": begun["job"]})["job_done"])
    return night.diagnosis.answer({"do": "adopt", "job": begun["job"]})


@pytest.fixture
def report(tmp_path: Path) -> Path:
    folder = tmp_path / "reports" / "2026-07-01_0300"
    folder.mkdir(parents=True)
    (folder / "diagnosis.json").write_text("{}")
    return folder


@pytest.mark.parametrize(("how", "word"), [("shadow", "--shadow"), ("activate", "--activate")])
def test_a_person_has_a_twin_adopted_where_no_diagnosis_runs_at_night(tmp_path, report, how, word):
    with Night(tmp_path, diagnose="never", adopt="never") as night:
        assert adopted(night, report=report.name, how=how)["job_error"] == ""
        told = night.told("diagnosis.adopted")
        night.strike_three()
    assert told == ("the twin of 2026-07-01_0300 is adopted: bundle 1.0-twin is installed, by Ann (page)")
    [call] = night.calls
    assert call.endswith(f"twin adopt {report} {word} --config {tmp_path}/edge.yaml")


def test_an_adoption_that_is_refused_is_told_with_its_reason(tmp_path, report):
    with Night(tmp_path, "sys.exit('no key to sign with')") as night:
        assert adopted(night, report=report.name)["job_error"] == ("adopt: ended with 1: no key to sign with")
        assert night.told("diagnosis.failed").endswith("no key to sign with, by Ann (page)")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"report": "2026-07-02_0300"}, "there is no report"),
        ({"report": "../reports/2026-07-01_0300"}, "adopt: report"),
        ({"report": "/etc"}, "adopt: report"),
        ({"report": "."}, "adopt: report"),
        ({"report": ".."}, "adopt: report"),
        ({"report": "link"}, "there is no report"),
        ({"report": 5}, "adopt: report"),
        ({}, "there is no report None"),
        ({"report": "2026-07-01_0300", "how": "sideways"}, "'sideways' is none of shadow, activate"),
        ({"report": "2026-07-01_0300", "key": "/etc/key"}, "unknown key 'key'"),
        ({"job": 7}, "job: 7 is forgotten"),
    ],
)
def test_an_order_that_names_no_report_is_refused(tmp_path, report, values, reason):
    (report.parent / "link").symlink_to(report)
    with Night(tmp_path) as night:
        answer = night.diagnosis.answer({"do": "adopt", **values})
    assert (answer["ok"], reason in answer["error"]) == (False, True), answer
    assert night.calls == []


def test_an_order_waits_for_no_diagnosis(tmp_path, report):
    with Night(tmp_path, "time.sleep(60)") as night:
        night.strike_three()
        wait_for(lambda: night.calls)
        answer = night.diagnosis.answer({"do": "adopt", "report": report.name})
    assert "a diagnosis or an adoption is under way" in answer["error"]


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
        assert "took longer than 0.05 min" in night.told("diagnosis.failed")
    assert len(night.calls) == 1


class Limited:
    """The settings with less patience than a setting may have: 3 s, so that a process has begun."""

    diagnose_max_min = 0.05

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


# the daemon asks by a file, a unit of its own runs the command and answers

HERE = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def short_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nightly_diagnosis, "LOOK_S", 0.02)
    monkeypatch.setattr(nightly_diagnosis, "START_MAX_S", 5.0)


@contextmanager
def path_unit(folder: Path, script: str) -> Iterator[None]:
    """Do as systemd does: start the service once the request is there."""
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            if (folder / REQUEST).exists():
                serve(folder, (sys.executable, "-c", script))
            over.wait(0.02)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join(10.0)


def asked(folder: Path, script: str, patience_s: float = 20.0) -> int | str:
    with path_unit(folder / "requests", script):
        return ask(folder / "requests", ["twin", "diagnose"], folder / "log.txt", patience_s, lambda: False)


@pytest.mark.parametrize(
    ("script", "code"),
    [
        ("import sys; print(sys.argv[1:])", 0),
        ("import sys; sys.exit(3)", 3),
        ("import os; os.kill(os.getpid(), 9)", -9),
    ],
)
def test_the_answer_is_how_the_command_ended(tmp_path: Path, script: str, code: int) -> None:
    assert asked(tmp_path, script) == code
    assert not (tmp_path / "requests" / REQUEST).exists()
    if code == 0:
        assert (tmp_path / "log.txt").read_text() == "['twin', 'diagnose']\n"


def test_a_command_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    began = time.monotonic()
    assert asked(tmp_path, "import time; time.sleep(60)", patience_s=0.3) == LATE
    assert time.monotonic() - began < 20.0


def test_an_old_answer_is_not_taken_for_a_new_one(tmp_path: Path) -> None:
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests" / ANSWER).write_text('{"code": 0}')
    assert asked(tmp_path, "import sys; sys.exit(4)") == 4


def test_without_the_unit_the_failure_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nightly_diagnosis, "START_MAX_S", 0.1)
    with pytest.raises(BackgroundFailure, match=r"greenhouse-diagnosis\.path is not active"):
        ask(tmp_path / "requests", ["twin"], tmp_path / "log.txt", 1.0, lambda: False)
    assert not (tmp_path / "requests").exists()  # no request is left for a unit that is enabled later


@pytest.mark.parametrize("way", ["close", "kill"])
def test_the_command_ends_with_the_daemon(tmp_path: Path, way: str) -> None:
    """The daemon removes the folder as it ends; where it was killed systemd does, its RuntimeDirectory=."""
    folder, pid_file = tmp_path / "requests", tmp_path / "pid"
    script = f"import os, time; open({str(pid_file)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    over = threading.Event()

    def daemon() -> None:
        with pytest.raises(BackgroundFailure):
            ask(folder, ["twin"], tmp_path / "log.txt", 60.0, over.is_set)

    thread = threading.Thread(target=daemon)
    with path_unit(folder, script):
        thread.start()
        wait_for(lambda: pid_file.exists() and pid_file.read_text())
        if way == "kill":
            nightly_diagnosis.shutil.rmtree(folder)
        over.set()
        thread.join(10.0)
        wait_for(lambda: not is_alive(int(pid_file.read_text())))


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_unit_is_started_as_a_program(tmp_path: Path) -> None:
    """As deploy/greenhouse-diagnosis.service does; the command here is one that is refused."""
    folder = tmp_path / "requests"
    started: list[subprocess.Popen[bytes]] = []

    def start_unit() -> bool:
        if not started and (folder / REQUEST).exists():
            command = [sys.executable, "-m", "edge.app.nightly_diagnosis", str(folder)]
            started.append(subprocess.Popen(command, cwd=HERE))
        return False

    code = ask(folder, ["twin", "nonsense"], tmp_path / "log.txt", 60.0, start_unit)
    assert code == 2
    assert "nonsense" in (tmp_path / "log.txt").read_text()
    assert started[0].wait(20.0) == 0


def test_a_night_is_asked_of_the_unit_and_a_kill_by_its_limit_is_told(tmp_path: Path) -> None:
    requests = tmp_path / "requests"
    with (
        path_unit(requests, "import os; os.kill(os.getpid(), 9)"),
        Night(tmp_path, requests=requests) as night,
    ):
        night.strike_three()
        assert "ended with -9: it needed more memory than it may have" in night.told("diagnosis.failed")
    assert night.calls == []
