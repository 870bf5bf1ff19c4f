"""The diagnosis at night: `greenhouse twin diagnose` over the stored history, as a process of its own.

Control never waits for it: it runs at the lowest priority of processor and disk, one at a time, for a limited
time and with limited memory, and ends with the daemon. On a rig a unit of systemd runs it; elsewhere it is
a child process. A twin that it finds goes no further than the settings say.

The daemon can start no process outside its own memory limit, so it writes a request into a folder; a path
unit of systemd sees it and starts `python -m edge.app.nightly_diagnosis FOLDER` with another limit. The
folder lives as long as the daemon: however the daemon ends, the folder is removed, and the command ends
with it.
"""

import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, time, tzinfo
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Annotated, Any, Literal

from edge.bundle.manifest import FILE_NAME
from edge.config.settings import DriftSettings
from edge.core.clock import Clock
from edge.core.errors import RequestError
from edge.core.messages import DriftState, Event, Severity, TickRecord
from edge.core.plain_text import plain, quote
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.reader import DocumentError, Foreign, parse_json, read, read_bytes, read_json
from edge.tick.orders import read_request, with_author
from edge.tick.reference import seconds_of_day

GREENHOUSE = (sys.executable, "-m", "edge")
REQUEST, ANSWER = "request", "answer"
START_MAX_S = 120.0  # for systemd to take up a request, on a busy single-board computer
END_MAX_S = 60.0  # for an answer after the time that the request allows
LOOK_S = 0.5
LATE = "late"  # instead of an exit code
_ONE_REQUEST = threading.Lock()  # the unit's folder holds one request: a diagnosis or a commissioning waits


@dataclass(frozen=True, slots=True)
class UnitRequest:
    """The file through which the daemon asks."""

    words: Annotated[tuple[str, ...], Rule(least=1)]
    log: str
    patience_s: Annotated[float, Rule(above=0.0)]


@dataclass(frozen=True, slots=True)
class UnitAnswer:
    """The file through which the unit answers: an exit code, or LATE."""

    code: Any


class BackgroundFailure(Exception):
    """A command that was not run, or came to no end; the text is for people."""


def ask(
    folder: Path, words: Sequence[str], log: Path, patience_s: float, is_over: Callable[[], bool]
) -> int | str:
    """Have `greenhouse *words` run by the unit.

    is_over : the daemon ends, and the unit with it
    Returns : its exit code, below 0 the signal that ended it; LATE
    Errors : BackgroundFailure; DataError of an answer that can't be read
    """
    folder.mkdir(parents=True, exist_ok=True)
    request, answer = folder / REQUEST, folder / ANSWER
    answer.unlink(missing_ok=True)
    # Who sees the file sees all of it.
    asked = {"words": list(words), "log": str(log), "patience_s": patience_s}
    write_atomically(request, json.dumps(asked))
    try:
        _wait(lambda: not request.exists(), START_MAX_S, is_over, "greenhouse-diagnosis.path is not active")
        _wait(answer.exists, patience_s + END_MAX_S, is_over, "greenhouse-diagnosis.service gave no answer")
    except BackgroundFailure:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    code = read_json(UnitAnswer, answer).code
    return code if isinstance(code, int) else LATE


def serve(folder: Path, program: Sequence[str] = GREENHOUSE) -> int:
    """Take the request and run it; whatever way the command ends, an answer says how."""
    content = read_bytes(folder / REQUEST)
    (folder / REQUEST).unlink()  # first of all: while it is there the path unit starts this again
    code: int | str = 1
    try:
        request = read(UnitRequest, parse_json(content))
        code = _run([*program, *request.words], Path(request.log), request.patience_s, folder)
    finally:
        if folder.exists():
            write_atomically(folder / ANSWER, json.dumps({"code": code}))
    return 0


def _run(command: Sequence[str], log: Path, patience_s: float, folder: Path) -> int | str:
    until = monotonic() + patience_s
    with log.open("ab") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
        )
    try:
        while monotonic() < until and folder.exists():
            with suppress(subprocess.TimeoutExpired):
                return process.wait(LOOK_S)
        return LATE
    finally:
        with suppress(ProcessLookupError):  # whatever it started ends with it
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _wait(condition: Callable[[], bool], at_most_s: float, is_over: Callable[[], bool], failed: str) -> None:
    until = monotonic() + at_most_s
    while not condition():
        if is_over():
            raise BackgroundFailure("the daemon ends")
        if monotonic() > until:
            raise BackgroundFailure(failed)
        sleep(LOOK_S)


LATE_MAX_S = 3600.0  # a night whose hour went by while the rig was off, or its clock wrong, is left out
ADOPT_MAX_S = 600.0
ROWS_MAX = 6000  # newest of the history: four days of 60 s, which a diagnosis does in 250 MB
DATA_MAX_BYTES = 400 << 20  # of a child's memory that is its own; the unit has MemoryMax= instead
REPORTS_KEPT = 30
LOG = "log.txt"
_LOWEST = (  # each where the machine has it
    ("setpriv", "--pdeathsig", "KILL"),  # ends with the thread that started it
    ("choom", "-n", "1000", "--"),  # the first that the kernel ends when memory runs out
    ("prlimit", f"--data={DATA_MAX_BYTES}"),
    ("nice", "-n", "19"),
    ("ionice", "-t", "-c", "3"),
)
_HOW = {"shadow": "--shadow", "activate": "--activate"}  # settings.drift.adopt -> of `twin adopt`
DIAGNOSIS = "diagnosis.json"
ERROR_MAX = 400  # characters of what is said of an adoption that failed


@dataclass(frozen=True, slots=True)
class AdoptRequest:
    """Keys of the request.

    report : name of a folder in `drift.reports`; how : as `drift.adopt`
    job : of an earlier request, whose outcome is asked for
    """

    report: Annotated[str, Rule(pattern=FILE_NAME.pattern)] | None = None
    how: Literal["shadow", "activate"] = "shadow"
    job: int | None = None


@dataclass(slots=True)
class Adoption:
    """An adoption that a person asked for. error : None while it is under way, "" where it succeeded"""

    number: int
    error: str | None = None


@dataclass(frozen=True, slots=True)
class Places:
    """The files and folders of a diagnosis.

    twin : file of the running twin, None while none runs
    config : edge.yaml of this daemon, None where it has none
    on_trial : a bundle is being compared with the active one: another would end its trial
    requests : folder in which a unit of systemd looks for requests; None: the diagnosis is a child
    """

    history: Path
    twin: Callable[[], Path | None]
    config: Path | None = None
    on_trial: Callable[[], bool] = lambda: False
    requests: Path | None = None


class BackgroundProcess:
    """Runs `greenhouse` at the lowest priority, one command at a time, by the unit or as a child.

    requests : folder in which the unit looks for requests; None: a child
    program : `greenhouse` as words of a command line
    """

    def __init__(self, requests: Path | None, program: Sequence[str] = GREENHOUSE) -> None:
        self._requests, self._program = requests, (*lowest_priority(), *program)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._closing = False

    def run(self, words: Sequence[str], log: Path, patience_s: float) -> int | str:
        """Wait for the command and return its exit code, below 0 the signal
        that ended it; LATE. Errors: BackgroundFailure
        """
        if self._requests is not None:
            with _ONE_REQUEST:
                return ask(self._requests, words, log, patience_s, lambda: self._closing)
        command = [*self._program, *words]
        with log.open("ab") as out, self._lock:
            if self._closing:
                raise BackgroundFailure("the daemon ends")
            # A group of its own, so that what it starts ends with it.
            process = self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
            )
        try:
            return process.wait(patience_s)
        except subprocess.TimeoutExpired:
            _kill(process)
            process.wait()
            return LATE
        finally:
            with self._lock:
                self._process = None

    def close(self) -> None:
        """Kill what runs; nothing is run any more."""
        with self._lock:
            self._closing = True
            if self._process is not None:
                _kill(self._process)


class NightlyDiagnosis:
    """A sink of tick records: a tick at the set hour starts it. Adopts twins of its reports when it is asked.

    program : `greenhouse` as words of a command line
    """

    def __init__(
        self,
        settings: DriftSettings,
        places: Places,
        clock: Clock,
        zone: tzinfo | None = None,
        program: Sequence[str] = GREENHOUSE,
    ) -> None:
        self._settings, self._places, self._clock, self._zone = settings, places, clock, zone
        self._background = BackgroundProcess(places.requests, program)
        self._before_utc: float | None = None
        self._told: deque[tuple[str, Severity, str]] = deque()
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._beginning = threading.Lock()
        self._busy = False
        self._adoption = Adoption(0)  # the last one that was asked for
        self._thread = threading.Thread(target=self._run, name="diagnosis", daemon=True)
        self._thread.start()

    def write(self, record: TickRecord) -> None:
        """Start a diagnosis if it is time. Never waits."""
        before, self._before_utc = self._before_utc, record.utc
        disagrees = record.drift is not None and record.drift.state is DriftState.DISAGREES
        wanted = {"never": False, "disagrees": disagrees, "always": True}[self._settings.diagnose]
        if not wanted or before is None:
            return
        if is_due(before, record.utc, self._settings.diagnose_at, self._zone):
            name = datetime.fromtimestamp(record.utc, self._zone).strftime("%Y-%m-%d_%H%M")
            self._begin(partial(self._diagnose, Path(self._settings.reports) / name))

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Begin to adopt the twin of a report, or say how an adoption went. Never waits, never raises."""
        try:
            asked = read_request(AdoptRequest, request)
            if asked.job is not None:
                return {"ok": True, **self._outcome(asked.job)}
            report = self._report(asked.report)
            adoption = Adoption(self._adoption.number + 1)
            if not self._begin(partial(self._adopt_asked, adoption, report, _HOW[asked.how], request)):
                raise RequestError("adopt: a diagnosis or an adoption is under way: try again after it")
        except RequestError as error:
            return {"ok": False, "error": str(error)}
        self._adoption = adoption
        return {"ok": True, "job": adoption.number}

    def faults(self) -> Mapping[str, str]:
        """Return no fault: a failed diagnosis is an event, nothing here lasts."""
        return {}

    def events_pending(self) -> list[Event]:
        """Return the events since the last call. The control thread calls this."""
        now, utc = self._clock.now(), self._clock.utc()
        told = [self._told.popleft() for _ in range(len(self._told))]
        return [Event(key, severity, text, now, utc) for key, severity, text in told]

    def close(self) -> None:
        """Kill what runs, and end the thread."""
        self._background.close()
        self._jobs.put(None)
        self._thread.join(timeout=5.0)

    def _begin(self, job: Callable[[], None]) -> bool:
        """Hand a job to the thread; False where one is under way."""
        with self._beginning:
            if self._busy:
                return False
            self._busy = True
            self._jobs.put(job)
            return True

    def _report(self, name: str | None) -> Path:
        """Return the folder of a report. Errors: RequestError"""
        folder = Path(self._settings.reports) / (name or "")
        if name is None or folder.is_symlink() or not (folder / DIAGNOSIS).is_file():
            raise RequestError(f"adopt: report: there is no report {quote(name)} in {folder.parent}")
        return folder

    def _outcome(self, job: int) -> dict[str, Any]:
        last = self._adoption
        if job != last.number:
            raise RequestError(f"adopt: job: {job} is forgotten")
        return {"job_done": last.error is not None, "job_error": last.error or ""}

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except BackgroundFailure as failure:
                self._tell("diagnosis.failed", str(failure), Severity.WARNING)
            except Exception as error:  # a full disk, a bug: told, and the next night tries again
                self._tell("diagnosis.failed", f"{type(error).__name__}: {error}", Severity.WARNING)
            with self._beginning:
                self._busy = False

    def _diagnose(self, report: Path) -> None:
        settings, places = self._settings, self._places
        twin = places.twin()
        if twin is None:
            raise BackgroundFailure("no twin runs, so there is none to diagnose")
        report.mkdir(parents=True, exist_ok=True)
        prune(report.parent)
        self._tell("diagnosis.started", f"the diagnosis of the last {settings.diagnose_since_d:g} days began")
        given = (
            "--history",
            places.history,
            "--since",
            f"{settings.diagnose_since_d:g}d",
            "--rows",
            str(ROWS_MAX),
            "--twin",
            twin,
        )
        self._call(("diagnose", *given, "--out", report), report / LOG, 60.0 * settings.diagnose_max_min)
        try:
            found = read_json(Findings, report / DIAGNOSIS)
        except DocumentError as error:
            raise BackgroundFailure(str(error)) from error
        self._tell("diagnosis.done", f"{_in_words(found)}; report: {report}")
        if found.twin_after and settings.adopt in _HOW:
            self._adopt(report)

    def _adopt(self, report: Path) -> None:
        if self._places.on_trial():
            self._tell("diagnosis.kept", f"a bundle is on trial, so the twin stays in {report}")
            return
        self._tell("diagnosis.adopted", self._run_adoption(report, _HOW[self._settings.adopt]))

    def _adopt_asked(self, adoption: "Adoption", report: Path, how: str, request: Mapping[str, Any]) -> None:
        """Adopt what a person asked for; its outcome is told with their name."""
        error = "internal error"
        try:
            said = f"the twin of {report.name} is adopted: {self._run_adoption(report, how)}"
            self._tell("diagnosis.adopted", with_author(said, request))
            error = ""
        except (BackgroundFailure, OSError) as failure:
            error = plain(str(failure), ERROR_MAX)
            self._tell("diagnosis.failed", with_author(f"{report.name}: {error}", request), Severity.WARNING)
        finally:
            adoption.error = error

    def _run_adoption(self, report: Path, how: str) -> str:
        """Adopt the twin of a report and return the command's last line. Errors: as `_call`; OSError"""
        config = () if self._places.config is None else ("--config", self._places.config)
        self._call(("adopt", report, how, *config), report / LOG, ADOPT_MAX_S)
        return _last_line(report / LOG)

    def _call(self, words: Sequence[str | Path], log: Path, patience_s: float) -> None:
        """Run `greenhouse twin ...` to its end. Errors: BackgroundFailure"""
        code = self._background.run(["twin", *map(str, words)], log, patience_s)
        if code == LATE:
            raise BackgroundFailure(f"{words[0]}: took longer than {patience_s / 60.0:g} min and was ended")
        if code != 0:
            raise BackgroundFailure(f"{words[0]}: ended with {code}: {_cause(code, _last_line(log))}")

    def _tell(self, key: str, text: str, severity: Severity = Severity.INFO) -> None:
        self._told.append((key, severity, text))


@dataclass(frozen=True, slots=True)
class FoundEffect(Foreign):
    """Part of diagnosis.json."""

    name: str


@dataclass(frozen=True, slots=True)
class Findings(Foreign):
    """Part of diagnosis.json: what is reported in one sentence."""

    verdict: str = ""
    effects: tuple[FoundEffect, ...] = ()
    depends_on: tuple[str, ...] = ()
    twin_after: str | None = None


def is_due(before_utc: float, utc: float, at: time, zone: tzinfo | None) -> bool:
    """Return whether the local time `at` lies between two ticks that are not far apart."""
    at_s = at.hour * 3600.0 + at.minute * 60.0
    ago_s = (seconds_of_day(utc, zone) - at_s) % 86400.0
    return ago_s < min(utc - before_utc, LATE_MAX_S)


def lowest_priority() -> tuple[str, ...]:
    """Words before a command that give it the lowest priority this machine knows."""
    return tuple(word for words in _LOWEST if shutil.which(words[0]) for word in words)


def prune(reports: Path) -> None:
    """Delete all but the newest reports. Errors: OSError"""
    folders = sorted(path for path in reports.iterdir() if (path / LOG).exists())
    for folder in folders[:-REPORTS_KEPT]:
        shutil.rmtree(folder)


def _kill(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)


def _in_words(found: Findings) -> str:
    if found.effects:
        return f"the diagnosis names {', '.join(effect.name for effect in found.effects)}"
    if found.verdict == "nothing_missing":
        return "the diagnosis finds nothing missing in the twin"
    on = ", ".join(found.depends_on) or "nothing it knows"
    return f"the diagnosis finds no name for what is missing; it depends on {on}"


def _cause(code: int | str, said: str) -> str:
    """Return the command's last words, and that its memory limit ended it where that is so."""
    if code == -signal.SIGKILL or "MemoryError" in said:
        return f"it needed more memory than it may have; {said}"
    return said


def _last_line(log: Path) -> str:
    """Return the command's last line, "" where it said nothing."""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


if __name__ == "__main__":
    sys.exit(serve(Path(sys.argv[1])))
