"""The step tests on a rig: through the daemon's own loop and safety, and what the history holds of them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import Any

from edge.app.daemon import Daemon
from edge.app.experiment import refuse_stopped
from edge.app.step_test_rows import StepTestCourse, stop_reason
from edge.board.serial_port import OpenPort, SerialPort
from edge.config.settings import BundleSettings, DriftSettings, Settings
from edge.controllers.step_tests import StepTests
from edge.core.clock import Clock
from edge.core.controller_names import RULES
from edge.core.errors import GreenhouseError
from edge.core.messages import ReadingQuality, TickRecord
from edge.formats.run_file import RecordedRun
from edge.storage.runs import name_run

STEP_S = 10.0  # of the step tests: fine enough for a fan that runs for a part of a minute
TEST_MINUTES = 120.0
BAND_BELOW_LIMIT_K = 3.0
RUN_NAME = "commissioning"
SAVE_ROWS = 60  # every ten minutes of tests


def test_settings(settings: Settings) -> Settings:
    """Return a rig's settings for its step tests: a finer step, and no model that could be in the way."""
    return replace(
        settings,
        control=replace(settings.control, step_s=STEP_S, controller=RULES, model=""),
        bundle=BundleSettings(path=""),
        drift=DriftSettings(enabled=False),
    )


def highest_c(settings: Settings) -> float:
    """Return the upper edge of the tests' band [°C]."""
    return settings.safety.temp_air_max_c - BAND_BELOW_LIMIT_K


def record(
    settings: Settings,
    clock: Clock,
    has_fan: bool,
    minutes: float = TEST_MINUTES,
    show: Callable[[TickRecord, float], None] = lambda tick, minutes_left: None,
    open_port: OpenPort = SerialPort,
    save: Callable[[RecordedRun], object] = lambda run: None,
    **daemon_fields: Any,
) -> RecordedRun:
    """Run the step tests and return what the history holds of them.

    Maintenance is a pause: its rows are left out and the tests last longer by it. An emergency stop or a trip
    ends the tests, and the run's fact `stopped` says so.

    settings : of `test_settings`
    save : takes what is recorded so far, so that a power cut leaves it
    daemon_fields : further ones of `Daemon`
    Errors : GreenhouseError without a good air temperature, or before there are rows to learn from
    """
    refuse_stopped(settings)
    tests, course = StepTests(highest_c(settings), has_fan), StepTestCourse()
    stopped, next_save = "", SAVE_ROWS
    daemon: Daemon

    def after_tick(tick: TickRecord) -> None:
        nonlocal stopped, next_save
        status = daemon.status()
        has_hands = status.operation.in_maintenance(tick.utc)
        course.take(tick, has_hands)
        (tests.pause if has_hands else tests.go_on)()
        show(tick, minutes - course.rows * STEP_S / 60.0)
        stopped = stop_reason(status)
        if stopped or course.rows * STEP_S >= 60.0 * minutes or not _is_good(course.first):
            daemon.stop()
        elif course.rows >= next_save:
            next_save += SAVE_ROWS
            saver.submit(_save, replace(course, pauses=[*course.pauses]), settings.history.path, save)

    daemon = Daemon(
        settings,
        clock,
        after_tick=after_tick,
        experiment=tests.name,
        more_controllers=(tests,),
        open_port=open_port,
        **daemon_fields,
    )
    # A thread of its own, as a slow disk must not hold up control.
    with ThreadPoolExecutor(1, "commission-save") as saver, daemon:
        daemon.run()
    if course.last is None or not _is_good(course.first):
        raise GreenhouseError(f"no good air temperature from the board at {settings.board.port}")
    run = course.run(settings.history.path, stopped)
    if not len(run):
        raise GreenhouseError("nothing is recorded: hands were in the box from the first row on")
    first, last = int(run.facts["first_seq"]), int(run.facts["last_seq"])
    name_run(settings.history.path, f"{RUN_NAME}@{first}", "", first, last, {"profile": RUN_NAME})
    return run


def _save(course: StepTestCourse, history: str, save: Callable[[RecordedRun], object]) -> None:
    with suppress(GreenhouseError):  # the next one comes in ten minutes
        save(course.run(history))


def _is_good(tick: TickRecord | None) -> bool:
    reading = None if tick is None else tick.readings.get("temp_air")
    return reading is not None and reading.quality is ReadingQuality.GOOD
