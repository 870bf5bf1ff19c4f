"""Commissioning: from a box of which only a description is known to a twin that controls it.

Step tests through the daemon's own loop and safety; the diagnosis fits the twin and names what it lacks; rows
that no fit saw say whether it is good enough, and an ARX model is fitted beside it as fallback. What is not
good enough is refused, with the reason.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.app.daemon import Daemon
from edge.app.experiment import refuse_stopped
from edge.board.serial_port import OpenPort, SerialPort
from edge.config.settings import BundleSettings, ControlSettings, DriftSettings, Settings
from edge.controllers.step_tests import StepTests
from edge.core.clock import Clock
from edge.core.controller import RULES
from edge.core.errors import DataError, GreenhouseError, RequestError
from edge.core.messages import ReadingQuality, TickRecord
from edge.diagnosis.adopted_twin import round_value
from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.diagnosis.progress import Progress
from edge.diagnosis.runs import FROM_S, diagnosis_runs
from edge.formats.run_file import RecordedRun, cut
from edge.models.fit_arx import ArxFit, fit_arx
from edge.storage.runs import export_run, name_run
from edge.twin.model import BoxTwin
from edge.twin.new_file import with_room_error
from edge.twin.plausible import implausible
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
STEP_S = 10.0  # of the step tests: fine enough for a fan that runs for a part of a minute
MINUTES = 120.0
TEST_SHARE = 0.25  # of the rows, the newest, that no fit sees
BAND_BELOW_LIMIT_K = 3.0
ERROR_MAX_K, ERROR_MAX_SHARE = 1.0, 0.15  # of free runs on those rows, and by the band that was seen
WORSE_AT_MOST = 0.8  # a simple twin that much better is taken, an ARX model that much better refuses
FINE_K = 0.2  # an error that good sensors have, with which a twin is not refused for a better ARX model
SEEN_MIN_K = 2.0  # that the air must have risen
LONGEST_MIN = 1440.0  # of tests that it proposes
RUN_NAME = "commissioning"


@dataclass(frozen=True, slots=True)
class Expectation:
    """The control that a twin promises, at the room of the tests and for as long as they took.

    What a box stores beyond that time they cannot tell, nor what happens in warmer air than they saw.

    hours : of the tests; seen_c : warmest air in them
    room_c : in the mean, fitted where no sensor tells
    reach_c : air after `hours` of full heat, from the room's temperature; beyond `seen_c` a guess
    fanned_c : after `hours` of fan without heat, NaN without one that cools
    error_k : of free runs over rows that no fit saw; hold_w_k : heat for 1 K over the room after `hours`
    """

    hours: float
    seen_c: float
    room_c: float
    reach_c: float
    fanned_c: float
    error_k: float
    hold_w_k: float


@dataclass(frozen=True, slots=True, eq=False)
class Commissioned:
    """A twin for the rig's control step and how good it is.

    names : effects that the twin has beside those of the description
    refusals : why it must not control, empty where it may
    arx : the fallback, None where none could be fitted
    """

    twin: TwinFile
    names: tuple[str, ...]
    diagnosis: Diagnosis
    arx: ArxFit | None
    expectation: Expectation
    refusals: tuple[str, ...]


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
    minutes: float = MINUTES,
    show: Callable[[TickRecord], None] = lambda record: None,
    open_port: OpenPort = SerialPort,
) -> RecordedRun:
    """Run the step tests and return what the history holds of them.

    settings : of `test_settings`
    Errors : GreenhouseError without a good air temperature, or before there are rows to learn from
    """
    refuse_stopped(settings)
    tests = StepTests(highest_c(settings), has_fan)
    records: list[TickRecord] = []
    daemon: Daemon

    def after_tick(tick: TickRecord) -> None:
        records.append(tick)
        show(tick)
        if len(records) * STEP_S >= 60.0 * minutes or not _is_good(records[0]):
            daemon.stop()

    daemon = Daemon(
        settings,
        clock,
        after_tick=after_tick,
        experiment=tests.name,
        more_controllers=(tests,),
        open_port=open_port,
    )
    with daemon:
        daemon.run()
    if not records or not _is_good(records[0]):
        raise GreenhouseError(f"no good air temperature from the board at {settings.board.port}")
    first, last = records[0].seq, records[-1].seq
    name = f"{RUN_NAME}@{first}"
    name_run(settings.history.path, name, "", first, last, {"profile": RUN_NAME})
    run = export_run(settings.history.path, name=name)
    return replace(run, columns={key: values for key, values in run.columns.items() if key != "reference_c"})


def learn(
    run: RecordedRun, start: TwinFile, control: ControlSettings, progress: Progress, jobs: int = 1
) -> Commissioned:
    """Fit the twin to the tests and judge it.

    start : the box's description, values to be fitted in it
    control : its step, and the room that is assumed without a sensor
    Errors : RequestError for a box that did not answer, DataError for a run that nothing can be fitted to
    """
    if (moved_k := _moved_k(run)) < SEEN_MIN_K:
        minutes = len(run) * STEP_S / 60.0
        longer = 30.0 * math.ceil(minutes * SEEN_MIN_K / max(moved_k, 1e-9) / 30.0)
        raise RequestError(
            f"refused: the air moved by {moved_k:.1f} K in all of the tests, less than {SEEN_MIN_K:g} K: the "
            "heater is too small for this box or this time, not connected, or the sensor hangs where its "
            "heat does not come" + (f"; tests of {longer:g} minutes may do" if longer <= LONGEST_MIN else "")
        )
    begin_test = round((1.0 - TEST_SHARE) * len(run))
    train, test = cut(run, 0, begin_test), cut(run, begin_test, len(run))
    # One recording for both, so that its second part begins with all that the first one has stored.
    whole = replace(run, facts={**run.facts, FROM_S: f"{run.columns['time_s'][begin_test]:.3f}"})
    file, both = replace(start, sample_s=STEP_S), [("tests", whole)]
    found = diagnose(file, diagnosis_runs(both, both, file), progress, "greenhouse commission", jobs)
    chosen, error_k = _chosen(found)
    twin = replace(chosen, sample_s=control.step_s)
    room_c = float(np.nanmean(found.inputs.runs.ambient))
    hours = len(run) * STEP_S / 3600.0
    seen_c = float(np.nanmax(run.columns["temp_air_c"]))
    expectation = _expect(twin, room_c, error_k, hours, seen_c)
    refusals = (*_refusals(run, found, expectation), *implausible(chosen))
    if found.inputs.guessed:
        try:
            twin = with_room_error(twin, control.ambient_default_c, room_c)
        except DataError:
            refusals += (
                f"without a room sensor the tests tell a room of {room_c:.0f} °C: set "
                f"control.ambient_default_c, now {control.ambient_default_c:g} °C, near to it and learn "
                "again with --from-run",
            )
    return Commissioned(
        twin,
        tuple(sorted({*chosen.effects} - {*start.effects})),
        found,
        _fallback(train, test, control.step_s, start),
        expectation,
        refusals,
    )


def _chosen(found: Diagnosis) -> tuple[TwinFile, float]:
    """Return the twin that was found, or the baseline that predicts the held-out rows clearly better."""
    error_k, twins = found.test_k.get("after", math.nan), found.simple_twins
    simple = {name: error for name, error in found.test_k.items() if name in twins}
    best = min(simple, key=simple.__getitem__, default="")
    if not best or not simple[best] < WORSE_AT_MOST * error_k:
        return found.adopted, error_k
    origin = {key: value for key, value in found.adopted.provenance.items() if key not in ("added", "after")}
    after = {"test": {"rmse_k": round_value(simple[best])}}
    return replace(twins[best], provenance={**origin, "added": {}, "after": after}), simple[best]


def _refusals(run: RecordedRun, found: Diagnosis, expectation: Expectation) -> Iterator[str]:
    risen_k = _moved_k(run)
    limit_k = min(ERROR_MAX_K, ERROR_MAX_SHARE * risen_k)
    if not expectation.error_k <= limit_k:
        yield (
            f"over {TEST_SHARE:.0%} of the tests, which no fit saw, the twin is off by "
            f"{expectation.error_k:.2f} K, more than {limit_k:.2f} K"
        )
    simple = {name: error for name, error in found.test_k.items() if name not in ("before", "after")}
    if (
        simple
        and expectation.error_k > FINE_K
        and (best := min(simple, key=simple.__getitem__))
        and simple[best] < WORSE_AT_MOST * expectation.error_k
    ):
        yield f"{best} predicts these rows better, {simple[best]:.2f} K"


def _moved_k(run: RecordedRun) -> float:
    air = run.columns["temp_air_c"]
    return float(np.nanmax(air) - np.nanmin(air))


def _expect(file: TwinFile, room_c: float, error_k: float, hours: float, seen_c: float) -> Expectation:
    twin = file.twin()
    cools = file.fan_role == "exhaust"
    reach_c, still_c = (_after_c(twin, room_c, hours, duty, 0.0) for duty in (1.0, 0.0))
    fanned_c = _after_c(twin, room_c, hours, 0.0, 1.0) if cools else math.nan
    hold_w_k = twin.geometry.heater_max_w / max(reach_c - still_c, 1e-9)
    return Expectation(hours, seen_c, room_c, reach_c, fanned_c, error_k, hold_w_k)


def _after_c(twin: BoxTwin, room_c: float, hours: float, duty: float, fan: float) -> float:
    """Return the air after hours of the same inputs, from rest [°C]."""
    steps = max(round(3600.0 * hours / twin.step_s), 1)
    inputs = Commands(np.full((1, steps), duty), np.full((1, steps), fan))
    conditions = {name: np.zeros(steps) for name in twin.needs}
    rest = at_rest(twin, twin.signals.room(np.array(room_c)), room_c)
    return float(twin.rollout(rest, *inputs, room_c, conditions=conditions, before=inputs)[0, -1])


def _fallback(train: RecordedRun, test: RecordedRun, step_s: float, start: TwinFile) -> ArxFit | None:
    """Return an ARX model of the control step; None where the tests are too short for one."""
    has_fan = start.fan_role != "none" and bool(np.nanmax(train.columns["fan_on"]) > 0.0)
    has_room = np.isfinite(train.columns.get("temp_ambient_c", np.array([np.nan]))).all()
    try:
        return fit_arx(
            [train], [test], step_s, fan_input="on" if has_fan else None, with_ambient=bool(has_room)
        )
    except DataError:
        return None


def _is_good(record: TickRecord) -> bool:
    reading = record.readings.get("temp_air")
    return reading is not None and reading.quality is ReadingQuality.GOOD
