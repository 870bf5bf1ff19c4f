"""An experiment: a profile through the daemon's own loop and safety, recorded as a run."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from edge.app.daemon import Daemon
from edge.config.settings import Settings
from edge.controllers.input_profile import InputProfile
from edge.core.clock import Clock
from edge.core.errors import DataError, GreenhouseError
from edge.core.messages import ReadingQuality, TickRecord
from edge.core.version import __version__
from edge.formats.profile_file import Profile
from edge.formats.run_file import RecordedRun
from edge.state.store import STANDING, restore
from edge.storage.runs import export_run, name_run
from edge.tick.reference import Reference

ROLES = ("train", "validate", "test")


@dataclass(frozen=True, slots=True)
class Experiment:
    """The profile of an experiment and its options.

    profile : inputs (open loop), or a reference for `controller`
    length_s : a shorter time than the profile's, else infinity
    facts : for the run file, over those that are known here
    """

    profile: Profile
    controller: str = InputProfile.name
    length_s: float = float("inf")
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def end_s(self) -> float:
        """Time of the last tick since the first [s]."""
        return min(self.profile.end_s, self.length_s)


@dataclass(slots=True)
class ExperimentCourse:
    """The course of an experiment, tick by tick.

    record_from_s : since the first tick, when the run begins
    """

    record_from_s: float = 0.0
    first: TickRecord | None = None
    recorded: TickRecord | None = None  # the first one of the run
    last: TickRecord | None = None
    changes: Counter[str] = field(default_factory=Counter)  # rule -> commands of the run it changed

    @property
    def passed_s(self) -> float:
        """From the first tick to the last [s]."""
        return 0.0 if self.first is None or self.last is None else self.last.time_s - self.first.time_s

    def take(self, record: TickRecord) -> None:
        """One more tick."""
        self.first, self.last = self.first or record, record
        if self.recorded is None and self.passed_s >= self.record_from_s - 0.5 * record.step_s:
            self.recorded = record
        if self.recorded is not None:
            self.changes.update(dict.fromkeys((change.rule for change in record.changes), 1))


def run_experiment(
    experiment: Experiment, settings: Settings, clock: Clock
) -> tuple[RecordedRun, ExperimentCourse]:
    """Apply a profile to the rig of `settings` and return what the history holds of it.

    Ends with the profile, or early on SIGINT and SIGTERM: the run's notes tell. The run begins after the
    profile's lead-in, if it has one. The history calls it `<profile>@<first tick of the run>`.
    Errors : DataError for a profile that does not fit; GreenhouseError for a rig that is held off or silent,
        and for a stop before the run has begun
    """
    settings = _check(experiment, settings)
    course = ExperimentCourse(experiment.profile.record_from_s)
    daemon: Daemon

    def after_tick(record: TickRecord) -> None:
        course.take(record)
        if record is course.first and not _has_air_temperature(record):
            daemon.stop()
        # Half a step of slack: ticks come a little early or late, and a sum of steps is not exact.
        if course.passed_s >= experiment.end_s - 0.5 * record.step_s:
            daemon.stop()

    profile = experiment.profile
    daemon = Daemon(
        settings,
        clock,
        after_tick=after_tick,
        reference=_reference(profile),
        experiment=experiment.controller,
        more_controllers=() if profile.is_reference else (InputProfile(profile),),
    )
    with daemon:
        daemon.run()
    if course.first is None or course.last is None or not _has_air_temperature(course.first):
        raise GreenhouseError(f"no good air temperature from the board at {settings.board.port}")
    if course.recorded is None:
        raise GreenhouseError(f"{profile.path}: stopped during the lead-in: nothing is recorded yet")
    return _record(experiment, settings, course.recorded, course.last, course), course


def describe_changes(changes: Mapping[str, int]) -> str:
    """Which rules changed how many commands, in words."""
    if not changes:
        return "safety changed no command"
    rules = ", ".join(f"{rule} {count}" for rule, count in sorted(changes.items()))
    return f"safety changed commands: {rules}"


def _check(experiment: Experiment, settings: Settings) -> Settings:
    """Return the settings for this experiment. Errors as `run_experiment`"""
    profile, step_s = experiment.profile, settings.control.step_s
    recorded_s = experiment.end_s - profile.record_from_s
    if not recorded_s >= step_s:
        raise DataError(f"{profile.path}: {recorded_s:g} s are shorter than a step of {step_s:g} s")
    if np.abs(np.remainder(profile.record_from_s + 1e-6, step_s)) > 2e-6:
        raise DataError(f"{profile.path}: record_from_s: it must stand on a control step of {step_s:g} s")
    if profile.is_reference:
        targets, limits = profile.columns["reference_c"], settings.reference
        if not (targets.min() >= limits.min_c and targets.max() <= limits.max_c):
            allowed = f"reference.min_c..max_c, {limits.min_c:g}..{limits.max_c:g}"
            raise DataError(
                f"{profile.path}: reference_c: {targets.min():g}..{targets.max():g} leaves {allowed}"
            )
    elif np.any(np.abs(np.remainder(profile.columns["time_s"] + 1e-6, step_s)) > 2e-6):
        raise DataError(f"{profile.path}: time_s: rows must stand on control steps of {step_s:g} s")
    if "light" in profile.columns:  # the profile's word, not the clock's
        settings = replace(settings, lighting=replace(settings.lighting, enabled=False))
    refuse_stopped(settings)
    return settings


def refuse_stopped(settings: Settings) -> None:
    """Refuse an experiment on a rig that is held off: it would record hours of nothing."""
    standing = restore(STANDING, settings)
    if standing.broken:
        raise GreenhouseError(f"state_file: {standing.broken}")
    if standing.operation.emergency_stop or standing.memory.trips:
        held = ", ".join(standing.memory.trips) or "emergency stop"
        raise GreenhouseError(
            f"the rig is held off ({held}): release it with the daemon running, then try again"
        )


def _reference(profile: Profile) -> Reference | None:
    if not profile.is_reference:
        return None
    return Reference(profile.columns["time_s"], profile.columns["reference_c"])


def _has_air_temperature(record: TickRecord) -> bool:
    reading = record.readings.get("temp_air")
    return reading is not None and reading.quality is ReadingQuality.GOOD


def _record(
    experiment: Experiment, settings: Settings, first: TickRecord, last: TickRecord, course: ExperimentCourse
) -> RecordedRun:
    """Return the run as the history holds it."""
    profile = experiment.profile
    facts = {
        "rig": settings.mqtt.rig,
        "profile": profile.path.name,
        "controller": experiment.controller,
        "software": f"greenhouse-twin {__version__}",
        **({"record_from_s": f"{profile.record_from_s:g}"} if profile.record_from_s else {}),
        **experiment.facts,
    }
    notes = [facts.get("notes", ""), describe_changes(course.changes)]
    if course.passed_s < experiment.end_s - 0.5 * settings.control.step_s:
        notes.append(f"stopped after {course.passed_s / 60:.0f} of {experiment.end_s / 60:.0f} min")
    facts["notes"] = "; ".join(note for note in notes if note)
    name = f"{profile.path.stem}@{first.seq}"
    name_run(settings.history.path, name, facts.get("role", ""), first.seq, last.seq, facts)
    run = export_run(settings.history.path, name=name)
    columns = dict(run.columns)
    if not profile.is_reference:
        del columns["reference_c"]  # nobody followed it
    return replace(run, columns=columns)
