"""The target of the air temperature over time: constant, steps, daily, a ramp, or a CSV profile."""

import hashlib
from dataclasses import dataclass
from datetime import datetime, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import ReferenceSettings
from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.formats.profile_file import read_profile

Floats = NDArray[np.float64]
DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class Reference:
    """Breakpoints on an axis of seconds: since the start, or (`daily`) since local midnight."""

    times_s: Floats  # rising, first one may be above 0
    values_c: Floats  # same length [°C]
    daily: bool = False
    linear: bool = False  # between two breakpoints: a line, else the earlier value holds

    @property
    def sha256(self) -> str:
        """Return the hash that identifies this reference."""
        content = self.times_s.tobytes() + self.values_c.tobytes() + bytes([self.daily, self.linear])
        return hashlib.sha256(content).hexdigest()

    def at(self, since_start_s: Floats, since_midnight_s: Floats) -> Floats:
        """Targets at the given times, both axes of one shape [°C]."""
        if self.linear:
            return np.interp(since_start_s, self.times_s, self.values_c)
        times = since_midnight_s % DAY_S if self.daily else since_start_s
        index = np.searchsorted(self.times_s, times, side="right") - 1
        # Before the first breakpoint: yesterday's last one holds (daily), else the first one is taken early.
        index = index % len(self.times_s) if self.daily else np.maximum(index, 0)
        return np.asarray(self.values_c[index])

    def ahead(self, since_start_s: float, since_midnight_s: float, step_s: float, steps: int) -> Floats:
        """Targets for the next `steps` control steps, the one that begins now first [°C]."""
        offsets = step_s * np.arange(steps, dtype=np.float64)
        return self.at(since_start_s + offsets, since_midnight_s + offsets)


def zone_of(name: str) -> tzinfo | None:
    """Return the time zone of settings.timezone; None is the machine's own."""
    return None if name == "local" else ZoneInfo(name)


def seconds_of_day(utc: float, zone: tzinfo | None) -> float:
    """Local time of day [s since midnight]."""
    local = datetime.fromtimestamp(utc, zone) if zone else datetime.fromtimestamp(utc)
    return local.hour * 3600.0 + local.minute * 60.0 + local.second + local.microsecond * 1e-6


def make_reference(settings: ReferenceSettings) -> Reference:
    """Return the configured reference. Errors: DataError for a wrong CSV profile"""
    match settings.kind:
        case "steps":
            pairs = [(step.at_s, step.reference_c) for step in settings.steps]
            return Reference(*_columns(pairs))
        case "daily":
            pairs = [
                (day.at.hour * 3600.0 + day.at.minute * 60.0 + day.at.second, day.reference_c)
                for day in settings.daily
            ]
            return Reference(*_columns(pairs), daily=True)
        case "ramp":
            ramp = settings.ramp
            pairs = [(ramp.start_s, ramp.from_c), (ramp.start_s + ramp.duration_s, ramp.to_c)]
            return Reference(*_columns(pairs), linear=True)
        case "csv":
            return reference_from_profile(Path(settings.csv))
    return Reference(*_columns([(0.0, settings.reference_c)]))


def reference_from_profile(path: Path) -> Reference:
    """Return the reference of a profile file with `time_s,reference_c`. Errors: DataError"""
    profile = read_profile(path)
    if not profile.is_reference:
        raise DataError(f"{path}: reference_c is not among the columns {quote(list(profile.columns), 500)}")
    return Reference(profile.columns["time_s"], profile.columns["reference_c"])


def _columns(pairs: list[tuple[float, float]]) -> tuple[Floats, Floats]:
    table = np.array(pairs, dtype=np.float64)
    return table[:, 0], table[:, 1]
