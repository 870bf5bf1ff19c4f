"""Commissioning at the press of a button, by the service itself.

The daemon ends, one for the step tests takes its place on the same board, and then one as before again:
orders and controller are those that stood. The twin is learned afterwards by a process of the lowest
priority, like the diagnosis at night. The process signs, activates and chooses the planner as the command
does.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edge.app.box import description_of
from edge.app.nightly_diagnosis import LATE, LOG, BackgroundFailure, BackgroundProcess
from edge.app.request_routes import ShowState
from edge.app.step_test_record import STEP_S, TEST_MINUTES, record, test_settings
from edge.app.step_test_rows import LEARN_MIN, STOPPED
from edge.config.settings import BoxSettings, Settings
from edge.core.clock import Clock
from edge.core.errors import GreenhouseError, RequestError
from edge.core.messages import TickRecord
from edge.core.names import SIGNALS
from edge.core.plain_text import plain
from edge.formats.run_file import RecordedRun, absence_facts, write_run
from edge.tick.inbox import Reply, Request
from edge.tick.orders import read_request
from edge.twin.twin_file import write_twin_file

BEGIN_AFTER_S = 1.0  # so that who pressed has the answer before the daemon ends
LEARN_MAX_S = 4 * 3600.0  # a single-board computer at the lowest priority takes its time
TEXT_MAX = 200
BUSY = ("tests", "paused", "learning")


@dataclass(frozen=True, slots=True)
class CommissionRequest:
    """Keys of the request. end : end the tests that run, learn nothing"""

    end: bool = False


@dataclass(frozen=True, slots=True)
class CommissionState:
    """The state as it is published. phase : idle, one of BUSY, done, refused or ended"""

    phase: str = "idle"
    text: str = "idle"

    def document(self) -> dict[str, str]:
        """As it is published."""
        return {"phase": self.phase, "text": plain(self.text, TEXT_MAX)}


class CommissionDesk:
    """Takes the presses, and says how far it is. Outlives the daemons of one service.

    config : edge.yaml, which the process that learns reads too
    process : runs `greenhouse` at the lowest priority; minutes : of the tests
    """

    def __init__(
        self, settings: Settings, config: Path, process: BackgroundProcess, minutes: float = TEST_MINUTES
    ) -> None:
        self._minutes = minutes
        self._settings, self._config, self._process = settings, config, process
        self._lock = threading.Lock()
        self._state = CommissionState()
        self._show: ShowState = lambda state: None
        self._stop_daemon: Callable[[], None] = lambda: None
        self._learning: threading.Thread | None = None
        self._ended = self._signalled = False

    @property
    def is_due(self) -> bool:
        """True where the daemon has ended for the sake of tests, and by no signal."""
        return self._state.phase == "tests" and not self._signalled

    @property
    def is_over(self) -> bool:
        """True where a signal ends the service."""
        return self._signalled

    def serve(self, stop_daemon: Callable[[], None], show: ShowState | None) -> None:
        """Take a new daemon's way to its end, and where its telemetry wants to see the state."""
        self._stop_daemon = stop_daemon
        self._show = show or (lambda state: None)
        self._show(self._state.document())

    def signal(self) -> None:
        """Note that the whole service ends."""
        self._signalled = True

    def answer(self, request: Request, status: Callable[[], Reply]) -> Reply:
        """Begin or end commissioning. status : asks the control loop. Never raises"""
        try:
            wish = read_request(CommissionRequest, request)
            return self._end() if wish.end else self._begin(status())
        except GreenhouseError as error:
            if self._state.phase not in BUSY:
                self._set("refused", f"refused: {error}")
            return {"ok": False, "error": str(error)}

    def make_tests(
        self, clock: Clock, on_tick: Callable[[TickRecord], None] = lambda tick: None, **daemon: Any
    ) -> None:
        """Run the step tests, in the place of the daemon that has ended; then begin to learn.

        daemon : further fields of the tests' daemon
        """
        try:
            folder, run = self._record(clock, on_tick, daemon)
        except (GreenhouseError, OSError) as error:  # a full disk too: the daemon from before takes over
            self._set("refused", f"refused: {error}")
            return
        reason = "ended by a person" if self._ended else run.facts.get(STOPPED, "")
        if not reason and len(run) * STEP_S < 60.0 * LEARN_MIN:
            reason = f"{len(run) * STEP_S / 60.0:.0f} min are recorded"
        if reason or self._signalled:
            self._set("ended", f"ended: {reason or 'the service was stopped'}; {folder / 'run.csv'} is kept")
            return
        self._set("learning", "learning")
        self._learning = threading.Thread(target=self._learn, args=(folder,), daemon=True)
        self._learning.start()

    def close(self) -> None:
        """End the process that learns."""
        self._process.close()
        if self._learning is not None:
            self._learning.join(5.0)

    def _begin(self, status: Mapping[str, Any]) -> Reply:
        with self._lock:
            if self._state.phase in BUSY:
                raise RequestError(f"commissioning runs already: {self._state.text}")
            if reason := refusal(self._settings, status):
                raise RequestError(reason)
            self._ended = False
            self._set("tests", f"tests 0 of {self._minutes:.0f} min")
        threading.Timer(BEGIN_AFTER_S, self._stop_daemon).start()
        return {"ok": True, "commissioning": self._state.document()}

    def _end(self) -> Reply:
        if self._state.phase not in ("tests", "paused"):
            raise RequestError("no step tests run")
        self._ended = True
        threading.Timer(BEGIN_AFTER_S, self._stop_daemon).start()
        return {"ok": True, "commissioning": self._state.document()}

    def _record(
        self, clock: Clock, on_tick: Callable[[TickRecord], None], daemon: Mapping[str, Any]
    ) -> tuple[Path, RecordedRun]:
        start = description_of(Path(self._settings.box.twin))
        name = f"commissioning-{datetime.fromtimestamp(clock.utc(), UTC):%Y-%m-%d_%H%M%S}"
        folder = Path(self._settings.state_file).parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_twin_file(start, folder / "box.yaml")
        except OSError as error:
            raise RequestError(f"{folder}: can't be written: {error.strerror or error}") from None
        settings = replace(self._settings, box=BoxSettings(str(folder / "box.yaml")))

        def show(tick: TickRecord, minutes_left: float) -> None:
            made = f"{self._minutes - minutes_left:.0f} of {self._minutes:.0f} min"
            is_paused = tick.decision.why.get("leg") == "pause"
            self._set("paused" if is_paused else "tests", f"{'paused, ' if is_paused else ''}tests {made}")
            on_tick(tick)

        def save(run: RecordedRun) -> None:
            write_run(absence_facts(run), folder / "run.csv")

        run = record(
            test_settings(settings),
            clock,
            start.fan_role != "none",
            self._minutes,
            show,
            save=save,
            commissioning=self,
            **daemon,
        )
        save(run)
        return folder, run

    def _learn(self, folder: Path) -> None:
        words = ["commission", "--from-run", folder / "run.csv", "--out", folder, "--config", self._config]
        log = folder / LOG
        try:
            code = self._process.run([*map(str, words)], log, LEARN_MAX_S)
        except BackgroundFailure as failure:
            self._set("refused", f"not learned: {failure}; {folder / 'run.csv'} is kept")
            return
        said = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing was said"]
        refused = [line for line in said if line.startswith("refused: ")]
        if code == 0:
            promised = next((line for line in said if "of full heat reach" in line), said[-1])
            self._set("done", f"done: {promised}")
        elif refused:
            self._set("refused", refused[0])
        else:
            late = f"not learned within {LEARN_MAX_S / 3600.0:g} h"
            self._set("refused", late if code == LATE else f"not learned: {said[-1]}")

    def _set(self, phase: str, text: str) -> None:
        state = CommissionState(phase, text)
        if state != self._state:
            self._state = state
            self._show(state.document())


def refusal(settings: Settings, status: Mapping[str, Any]) -> str:
    """Return why no tests may begin now, "" where they may.

    status : the control loop's answer to "status"
    Errors : DataError of the box's description
    """
    operation, tick = status.get("operation"), status.get("tick")
    if operation is None or tick is None:
        return str(status.get("error", "no tick has been made yet"))
    echo = status.get("echo")
    air = tick["readings"].get(SIGNALS["temp_air"].key, {})
    reasons = {
        "emergency stop: release it first": operation["emergency_stop"],
        f"tripped: {', '.join(map(str, status['trips']))}; clear it first": bool(status["trips"]),
        "maintenance: hands are in the box": operation["maintenance_until_utc"] is not None,
        f"mode {operation['mode']}: set auto first": operation["mode"] != "auto",
        "the board does not answer": echo is None or not status["link_up"],
        "the board has tripped": bool(echo and echo["tripped"]),
        "no good air temperature": air.get("quality") != "good",
        **_lacks(settings),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _lacks(settings: Settings) -> dict[str, bool]:
    """Return what the configuration must have, with whether it is missing."""
    if settings.box.twin:
        description_of(Path(settings.box.twin))  # a broken file is told now, not in two hours
    bundle, key = settings.bundle, settings.bundle.signing_key
    return {
        "no description of the box: `greenhouse setup` makes one": not settings.box.twin,
        "bundle.path is empty: there is no place for the twin": not bundle.path,
        "no key to sign with: bundle.signing_key names none": not key,
        f"{key}: no such key": bool(key) and not Path(key).exists(),
    }
