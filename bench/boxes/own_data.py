"""python -m bench.boxes.own_data: a box's twin after 1 h, 3 h, 12 h, 3 d and 7 d of its own data.

Two hours of step tests, then days held to a daily reference by MPC-Twin-P with the twin of those tests, or by
PID where commissioning refused it. The first two rows are learnt from the box's description, with half of the
tests and with all of them. From then on each row is what the diagnosis at night makes of the twin in use and
the newest rows so far: a twin that it does not offer is not taken, and the one before goes on. Each is judged
by a free run over the eighth day, which no fit saw, and by the cost of MPC-Twin-P with it.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from datetime import time as clock_time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.boxes.__main__ import OF_TWIN, description, drive, install, rig_settings
from bench.boxes.box import Box
from bench.boxes.draw import DEVELOPMENT, draw_box
from bench.boxes.facts import BoxFacts
from bench.boxes.reach import scaled_reference
from bench.boxes.tuned_pid import tune_pid
from bench.header import header
from edge.app.commission import Commissioned, learn
from edge.app.nightly_diagnosis import ROWS_MAX
from edge.app.step_test_record import record, test_settings
from edge.config.settings import ControlSettings, DailyReference, ReferenceSettings
from edge.core.errors import GreenhouseError
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.gap import forecast
from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import NamedRun
from edge.formats.run_file import RecordedRun, cut, resample
from edge.storage.runs import export_stretches
from edge.twin.twin_file import TwinFile
from firmware_protocol.virtual_board.plant import Plant
from training.lab import InProcessBoard, Lab

Floats = NDArray[np.float64]
SPANS_H = (1.0, 2.0, 3.0, 12.0, 72.0, 168.0)
TESTS_H, STEP_S = 2.0, 60.0
DAYS = 8  # of closed loop after the tests, the last one judges
WARM, COOL = 0.7, 0.25  # references by day and by night, shares as of scaled_reference
REFERENCE = "reference_1"


def quiet(text: str, share: float | None) -> None:
    """Show no progress."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnData:
    """The recordings of a box: its tests in steps of 10 s, then days in steps of a minute."""

    tests: RecordedRun
    days: RecordedRun

    def until(self, hours: float) -> list[RecordedRun]:
        """Return what was recorded in the first hours."""
        rows = round(3600.0 * (hours - TESTS_H) / STEP_S)
        return [self.tests, cut(self.days, 0, rows)]

    def later_day(self) -> RecordedRun:
        """Return the last day."""
        rows = round(86_400.0 / STEP_S)
        return resample(cut(self.days, len(self.days) - rows, len(self.days)), STEP_S)


def live(facts: BoxFacts, seed: int, folder: Path) -> tuple[OwnData, Commissioned]:
    """Commission a box and let it run for days. Errors: GreenhouseError where it cannot be learnt"""
    start, box = description(facts), Box(facts, seed)
    settings = rig_settings(folder, start)
    board = InProcessBoard(seed, plant=Plant(box, box.parts()))
    has_fan = start.fan_role != "none"
    tests = record(test_settings(settings), board, has_fan, 60.0 * TESTS_H, open_port=board.open)
    found = learn(tests, start, ControlSettings(), quiet)
    cool, warm = scaled_reference(np.array([COOL, WARM]), facts).tolist()
    steps = (DailyReference(clock_time(6), warm), DailyReference(clock_time(22), cool))
    settings = rig_settings(folder, found.twin)
    name = "rules" if found.refusals else OF_TWIN
    control = replace(settings.control, controller=name, time_box_ms=60_000.0)
    reference = ReferenceSettings(kind="daily", daily=steps, min_c=5.0)
    settings = replace(settings, control=control, reference=reference)
    install(found, settings, folder)
    instead: dict[str, Any] = {}
    if found.refusals:
        room_c = found.expectation.room_c if facts.room_sensor else settings.control.ambient_default_c
        courses = [np.repeat([cool, warm, cool], 120)]
        pid = tune_pid(found.twin.twin(), room_c, courses, facts.fan == "exchange")
        instead = {"more_controllers": [pid], "experiment": pid.name}
    lab = Lab(
        settings,
        board="here",
        plant=Plant(box, box.parts()),
        seed=seed,
        folder=folder,
        on_tick=lambda tick: lab.history.clear(),
        **instead,
    )
    with lab:
        lab.run(minutes=1440.0 * DAYS)
    *_, days = export_stretches(settings.history.path)
    # The clock of a new board begins anew; the days follow the tests.
    assert days.start_utc is not None
    begun = datetime.fromtimestamp(days.start_utc + 3600.0 * TESTS_H, UTC)
    dated = replace(days, facts={**days.facts, "start_utc": begun.isoformat(timespec="milliseconds")})
    return OwnData(tests, dated), found


def learn_more(data: OwnData, described: TwinFile, running: TwinFile, hours: float) -> TwinFile:
    """Return the twin that would run after the first hours. running : the one of the row before"""
    if hours <= TESTS_H:
        rows = round(hours / TESTS_H * len(data.tests))
        return learn(cut(data.tests, 0, rows), described, ControlSettings(), quiet).twin
    runs = history_runs(data.until(hours), running, rows_max=ROWS_MAX)
    found = diagnose(running, runs, quiet, "python -m bench.boxes.own_data")
    return found.adopted if found.is_offered else running


def free_run_k(twin: TwinFile, day: RecordedRun) -> float:
    """Return the error (RMS) of a free run over a day, which knows its first ten minutes [K]."""
    return float(np.sqrt(np.nanmean(free_run_errors(twin, day) ** 2)))


def free_run_errors(twin: TwinFile, day: RecordedRun) -> Floats:
    """Return measured minus predicted of a free run that knows the day's first ten minutes, [rows] [K]."""
    usual = np.full(len(day), ControlSettings().ambient_default_c)
    room = day.columns.get("temp_ambient_c", usual)
    known = np.flatnonzero(np.isfinite(room))
    rooms = np.interp(np.arange(len(day)), known, room[known])
    return np.asarray(forecast(twin.twin(), NamedRun("day", day, day.columns["time_s"]), rooms).residual)


def measure(number: int) -> list[str]:
    """Return a box's lines."""
    return list(_lines(number))


def _lines(number: int) -> Iterator[str]:
    facts = draw_box(number)
    with tempfile.TemporaryDirectory(prefix="own-data-") as temporary:
        try:
            data, found = live(facts, number, Path(temporary))
        except GreenhouseError as error:
            yield f"{number:3d} {facts.kind}: {error}"
            return
    day, start, running = data.later_day(), description(facts), found.twin
    air = day.columns["temp_air_c"]
    by = "PID, as commissioning refused the twin" if found.refusals else OF_TWIN
    low_c, high_c = np.nanmin(air), np.nanmax(air)
    yield f"{number:3d} {facts.kind}: days by {by}; the last goes from {low_c:.1f} to {high_c:.1f} °C"
    for hours in SPANS_H:
        begun = time.monotonic()
        try:
            twin = learn_more(data, start, running, hours)
        except GreenhouseError as error:
            yield f"    {hours:5.0f} h  {error}"
            continue
        is_kept = twin is running
        took_s, error_k = time.monotonic() - begun, free_run_k(twin, day)
        if hours >= TESTS_H:
            running = twin
        row = drive(facts, number, OF_TWIN, replace(found, twin=twin), REFERENCE)
        added = "kept" if is_kept else ", ".join(sorted({*twin.effects} - {*start.effects})) or "nothing"
        yield f"    {hours:5.0f} h{error_k:9.2f}{row.cost:9.1f}{row.mae_k:8.3f}{took_s:8.0f}  {added}"


def main(words: Sequence[str] | None = None) -> int:
    """Print a table per box."""
    parser = argparse.ArgumentParser(prog="python -m bench.boxes.own_data", description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", choices=DEVELOPMENT, default=[5, 8, 9, 14])
    parser.add_argument("--jobs", type=int, default=1, help="processes; default: 1")
    given = parser.parse_args(words)
    print("\n".join(header()))
    print(f"own data, free run over a later day [K], cost of {OF_TWIN} on {REFERENCE}, its MAE [K], time of")
    print("the fit [s], effects added to the description", flush=True)
    with ProcessPoolExecutor(given.jobs) as pool:
        for job in [pool.submit(measure, number) for number in given.boxes]:
            print("\n".join(job.result()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
