"""The next experiment, as diagnosis.json and `greenhouse experiment` have it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edge.number_table import write_table
from edge.twin.diagnosis.experiment.advice import Calibration
from edge.twin.diagnosis.experiment.independent import calibration, checks
from edge.twin.diagnosis.experiment.wording import asks, why

PROFILE = "next_experiment.csv"
Sides = tuple[tuple[str, ...], ...]  # effects that are told from one another; several where they are not


@dataclass(frozen=True, slots=True)
class ProfileRow:
    """What holds from `time_s` on; the last row marks the end."""

    time_s: float
    heater_duty: float
    fan_on: float
    light: float | None = None


@dataclass(frozen=True, slots=True)
class Experiment:
    """What is to be done next.

    profile : rows for `greenhouse experiment`; none where no experiment with heater and fan can tell anything
    kind : of experiment, in words; separates : what it tells apart, for each effect's place
    expected_log_odds : of the true one over the one that is hardest to tell from it [nat]
    between : the same of each pair, `true over other`
    inseparable : groups of effects that say the same whatever heater and fan do
    weak : pairs of which it tells too little
    calibration : of a value that is better known first; None where that brings too little
    swing_log_odds : expected for what is hard to tell, if the room warms meanwhile; None where that is little
    """

    profile: tuple[ProfileRow, ...] = ()
    kind: str = ""
    separates: tuple[Sides, ...] = ()
    expected_log_odds: float | None = None
    largest_temp_air_c: float | None = None
    between: Mapping[str, float] = field(default_factory=dict)
    inseparable: tuple[tuple[str, ...], ...] = ()
    weak: tuple[tuple[str, str], ...] = ()
    calibration: Calibration | None = None
    swing_log_odds: float | None = None

    @property
    def names(self) -> list[str]:
        """Effects that it tells apart."""
        return list(dict.fromkeys(name for sides in self.separates for side in sides for name in side))

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return self.profile[-1].time_s if self.profile else 0.0

    def document(self) -> dict[str, Any]:
        """As diagnosis.json has it."""
        found: dict[str, Any] = {
            "why": why(self),
            "separates": self.names,
            "duration_s": self.duration_s,
            "expected_log_odds": self.expected_log_odds,
        }
        if self.profile:
            found |= {"profile": PROFILE, "kind": self.kind, "largest_temp_air_c": self.largest_temp_air_c}
        if self.between:
            found["expected_log_odds_of"] = dict(self.between)
        if self.inseparable:
            found["inseparable"] = [
                {"effects": list(group), "what_would": list(checks(group))} for group in self.inseparable
            ]
        if self.calibration is not None:
            found["calibrate_first"] = _calibration(self.calibration)
        if told := asks(self):
            found["asks"] = told
        return found


def write_profile(found: Experiment | None, folder: Path) -> None:
    """An experiment's profile into a folder, in the place of an older one. Errors: OSError"""
    path = folder / PROFILE
    if found is None or not found.profile:
        path.unlink(missing_ok=True)
        return
    columns = {
        "time_s": [row.time_s for row in found.profile],
        "heater_duty": [row.heater_duty for row in found.profile],
        "fan_on": [row.fan_on for row in found.profile],
    }
    if found.profile[0].light is not None:
        columns["light"] = [row.light or 0.0 for row in found.profile]
    aim = f", to separate {', '.join(found.names)}" if found.names else ""
    facts = {"notes": f"{found.kind}{aim}"}
    write_table(path, {name: np.array(values) for name, values in columns.items()}, facts)


def _calibration(item: Calibration) -> dict[str, Any]:
    found: dict[str, Any] = {
        "value": item.name,
        "how": calibration(item.place),
        "expected_log_odds": item.alone,
    }
    if item.with_experiment is not None:
        found["expected_log_odds_with_experiment"] = item.with_experiment
    return found
