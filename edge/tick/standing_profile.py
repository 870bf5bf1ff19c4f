"""A profile that a person starts: targets over days, which can be paused, skipped and taken up again.

Its time is its own. It stands still while it is paused and while everything is off by a person's hand, and
after a power cut it goes on where it was. A wall clock that is wrong after a start cannot move it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from edge.core.plain_text import plain
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.profile_file import REFERENCE_C
from edge.formats.reader import read
from edge.tick.reference import DAY_S, Reference

LONGEST_S = 400 * DAY_S
POINTS_MAX = 500
NAME_MAX = 40  # characters
SAVE_EVERY_S = 600.0  # of its time: what a power cut may take back; a write wears a card

Target = Annotated[float, Rule(low=REFERENCE_C[0], high=REFERENCE_C[1])]
Moment = Annotated[float, Rule(low=0.0, high=LONGEST_S)]


@dataclass(frozen=True, slots=True)
class StandingProfile(CheckedDocument):
    """A profile and how far it is. The last target holds until somebody ends it.

    times_s : rising from 0, in the profile's own time; targets_c : one for each [°C]
    is_linear : between two points a line, else the earlier target holds
    """

    name: Annotated[str, Rule(most=NAME_MAX)]
    times_s: Annotated[tuple[Moment, ...], Rule(least=1, most=POINTS_MAX)]
    targets_c: Annotated[tuple[Target, ...], Rule(least=1, most=POINTS_MAX)]
    is_linear: bool = field(default=False, metadata={"key": "linear"})
    position_s: Moment = 0.0
    is_paused: bool = field(default=False, metadata={"key": "paused"})

    def cross_check(self) -> None:
        """Check that it has a name, a target for each time, and times that rise from 0."""
        if not plain(self.name).strip():
            self.refuse("name", "is empty")
        if len(self.times_s) != len(self.targets_c):
            self.refuse("targets_c", f"{len(self.targets_c)} targets for {len(self.times_s)} times")
        if self.times_s[0] != 0.0:
            self.refuse("times_s", "the first one has to be 0")
        if any(not earlier < later for earlier, later in pairwise(self.times_s)):
            self.refuse("times_s", "has to rise from one to the next")

    @property
    def end_s(self) -> float:
        """When it is over, in its own time."""
        return self.times_s[-1]

    @property
    def is_over(self) -> bool:
        """The last target holds."""
        return self.position_s >= self.end_s

    @property
    def next_s(self) -> float | None:
        """The time of the next point, None after the last one."""
        return next((time_s for time_s in self.times_s if time_s > self.position_s), None)

    def later(self, seconds: float) -> "StandingProfile":
        """Return it after so long a time; no later than its end."""
        if self.is_paused or self.is_over:
            return self
        return replace(self, position_s=min(self.position_s + max(seconds, 0.0), self.end_s))

    def is_due(self, saved: "StandingProfile") -> bool:
        """Return whether it is worth a write. saved : itself, earlier"""
        return self.is_over != saved.is_over or (
            self.position_s // SAVE_EVERY_S != saved.position_s // SAVE_EVERY_S
        )

    def reference(self, since_start_s: float) -> Reference:
        """Return its targets on the axis of the daemon's time; the present one while it is paused."""
        times, targets = np.array(self.times_s), np.array(self.targets_c)
        own = Reference(times, targets, linear=self.is_linear)
        if self.is_paused:
            at = np.array([self.position_s])
            return Reference(np.zeros(1), own.at(at, at))
        return replace(own, times_s=times - self.position_s + since_start_s)

    def in_words(self) -> str:
        """Say how far it is."""
        state = "paused at " if self.is_paused else "over: " if self.is_over else ""
        return f"{plain(self.name, NAME_MAX)}, {state}{duration(self.position_s)} of {duration(self.end_s)}"


def profile_of(operation: Mapping[str, Any]) -> StandingProfile | None:
    """Return the profile of orders as the status has them, None where none is followed. Errors: DataError"""
    found = operation.get("profile")
    return None if found is None else read(StandingProfile, found, key="profile")


def duration(seconds: float) -> str:
    """Return a length of time in words: `2 d 3 h`, `3 h 20 min`, `20 min`."""
    minutes = round(seconds / 60.0)
    days, hours, minutes = minutes // 1440, minutes // 60 % 24, minutes % 60
    if days:
        return f"{days} d {hours} h"
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
