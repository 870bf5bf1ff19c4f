"""A recorded run in place of the serial board: the same tick, in shadow. What was recorded stands."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from edge.core.messages import AirSensorPair, Command, Echo, Event, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.formats.run_file import RecordedRun


class ReplayClock:
    """Time that moves as far as it is asked to."""

    def __init__(self, start_s: float, start_utc: float) -> None:
        self._now_s = start_s
        self._utc_offset = start_utc - start_s

    def now(self) -> float:
        """Time of the recording [s]."""
        return self._now_s

    def utc(self) -> float:
        """Seconds since 1970 of the recording."""
        return self._now_s + self._utc_offset

    def wait(self, port: object, wake: int | None, until_s: float) -> None:
        """Go there."""
        self._now_s = max(self._now_s, until_s)


class RecordedBoard:
    """Hands out the samples of a run and answers every command with what was really driven.

    run : columns by border key; `fan_on` missing means that it was on all the time if `fan_always_on`
    step_s : control step, over which the recorded inputs are averaged into one echo
    """

    def __init__(self, run: RecordedRun, clock: ReplayClock, step_s: float, fan_always_on: bool) -> None:
        self._times = run.columns["time_s"]
        self._clock = clock
        self._step_s = step_s
        self._signals = {name: run.columns[s.key] for name, s in SIGNALS.items() if s.key in run.columns}
        self._heater = run.columns["heater_duty"]
        self._fan = run.columns.get("fan_on", np.full(len(self._times), float(fan_always_on)))
        self._next = 0
        self._waiting: list[Mapping[str, Reading]] = []
        self.echo: Echo | None = None
        self.air_pair: AirSensorPair | None = None
        self._deliver()

    @property
    def link_up(self) -> bool:
        """A recording always answers."""
        return True

    @property
    def in_maintenance(self) -> bool:
        """No board holds the past."""
        return False

    @property
    def has_samples(self) -> bool:
        """A recorded row waits to be taken."""
        return bool(self._waiting)

    @property
    def statistics(self) -> Mapping[str, int]:
        """There is no line that could count."""
        return {}

    def take_samples(self) -> list[Mapping[str, Reading]]:
        """Return the rows since the last call."""
        samples, self._waiting = self._waiting, []
        return samples

    def take_events(self) -> list[Event]:
        """Return no event: a recording has none."""
        return []

    def drive(self, command: Command, cutoff_open: bool, step_s: float) -> None:
        """Ignore the command; the recorded one applies."""
        now = self._clock.now()
        rows = (self._times >= now - 1e-9) & (self._times < now + self._step_s - 1e-9)
        duty = float(np.nanmean(self._heater[rows])) if np.isfinite(self._heater[rows]).any() else 0.0
        fan = float(np.nanmean(self._fan[rows])) if np.isfinite(self._fan[rows]).any() else 0.0
        self.echo = Echo(duty, fan >= 0.5, 0.0, False, False, "", now)

    def serve(
        self, until_s: float, wake: int | None = None, done: Callable[[], bool] = lambda: False
    ) -> None:
        """Let the recording run to `until_s`."""
        self._clock.wait(None, wake, until_s)
        self._deliver()

    def serve_until_echo(self, timeout_s: float) -> Echo | None:
        """Return the recorded outputs, known at once."""
        return self.echo

    def serve_until_answered(self, timeout_s: float) -> bool:
        """Nothing is asked of the past, so nothing is unanswered."""
        return True

    def emergency_stop(self) -> None:
        """Nothing can stop the past."""

    def release_stop(self) -> None:
        """Nothing to release."""

    def maintain(self) -> None:
        """Nothing can stop the past."""

    def end_maintenance(self) -> None:
        """Nothing to end."""

    def clear_trip(self) -> None:
        """Nothing to clear."""

    def _deliver(self) -> None:
        now = self._clock.now()
        while self._next < len(self._times) and self._times[self._next] <= now + 1e-9:
            self._waiting.append(self._sample(self._next))
            self._next += 1

    def _sample(self, row: int) -> Mapping[str, Reading]:
        sample = {}
        for name in SIGNALS:
            column = self._signals.get(name)
            value = math.nan if column is None else float(column[row])
            quality = (
                ReadingQuality.ABSENT
                if column is None
                else ReadingQuality.GOOD
                if math.isfinite(value)
                else ReadingQuality.FAULT
            )
            number = value if math.isfinite(value) else None
            sample[name] = Reading(name, number, float(self._times[row]), quality)
        return sample
