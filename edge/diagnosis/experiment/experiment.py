"""The next experiment, as values."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edge.diagnosis.experiment.advice import ValueCalibration

Sides = tuple[tuple[str, ...], ...]  # effects that are told from one another; several where they are not


@dataclass(frozen=True, slots=True)
class ProfileRow:
    """Inputs from `time_s` on; the last row marks the end."""

    time_s: float
    heater_duty: float
    fan_on: float
    light: float | None = None


@dataclass(frozen=True, slots=True)
class PlannedExperiment:
    """The next experiment.

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
    calibration: ValueCalibration | None = None
    swing_log_odds: float | None = None

    @property
    def names(self) -> list[str]:
        """Effects that it tells apart."""
        return list(dict.fromkeys(name for sides in self.separates for side in sides for name in side))

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return self.profile[-1].time_s if self.profile else 0.0
