"""Writes the profiles of the test scenarios: `python -m training.data.draw_profiles`, half a minute.

Each is drawn at random on the default chamber, with both board seeds that the profile is recorded with, and
kept when both measured temperatures span the range of the paper (Table "Model experiment scenarios"). The box
is warm when the recording begins, so each profile has a lead-in that is applied but not recorded.
"""

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.profiles.record import SAMPLE_S, RecordedRow, drive, write

FOLDER = Path(__file__).parent / "profiles"
LEAD_IN_MIN, RECORDED_MIN = 40, 212
TOLERANCE_K = 0.25  # of the 0.3 K that a recorded run may miss; the rest is for its noise

Minutes = tuple[int, int]  # shortest and longest


@dataclass(frozen=True, slots=True)
class ProfilePlan:
    """The aim of one test profile.

    One minute of fan takes more than half of the box's excess over the room, so a fan that blew at any time
    would leave the range downwards: it waits for `fan_from_c`. Heating waits for no temperature but the
    ends of the range, `turn_c`.
    """

    character: str  # in the paper's words
    range_c: tuple[float, float]  # lowest and highest measured temperature
    board_seeds: tuple[int, int]  # of the interpolation and the extrapolation run; training has 1 to 15
    lead_in_duty: float
    duty: tuple[float, float]  # while heating
    heating: Minutes
    resting: Minutes  # between two heatings
    blowing: Minutes  # fan on
    still: Minutes  # between two fan periods, at least
    turn_c: tuple[float, float]  # heat from the lower one on, rest from the upper one on
    fan_from_c: float
    fan_minutes: int  # in all, at least


PLANS = (
    ProfilePlan(
        "heater mostly on, fan frequent",
        range_c=(25.5, 30.3),
        board_seeds=(25, 72),
        lead_in_duty=0.30,
        duty=(0.35, 0.55),
        heating=(15, 40),
        resting=(2, 4),
        blowing=(1, 1),
        still=(4, 9),
        turn_c=(26.0, 30.2),
        fan_from_c=29.9,
        fan_minutes=12,
    ),
    ProfilePlan(
        "sparse long heating, fan rare",
        range_c=(25.4, 30.0),
        board_seeds=(46, 52),
        lead_in_duty=0.35,
        duty=(0.40, 0.70),
        heating=(15, 30),
        resting=(20, 45),
        blowing=(1, 1),
        still=(40, 80),
        turn_c=(25.8, 29.6),
        fan_from_c=29.5,
        fan_minutes=2,
    ),
    ProfilePlan(
        "heater and fan both intermittent",
        range_c=(25.0, 33.3),
        board_seeds=(17, 67),
        lead_in_duty=0.35,
        duty=(0.50, 1.00),
        heating=(4, 14),
        resting=(3, 12),
        blowing=(1, 2),
        still=(8, 25),
        turn_c=(25.7, 32.6),
        fan_from_c=31.5,
        fan_minutes=8,
    ),
)


@dataclass(frozen=True, slots=True)
class ProfileCandidate:
    """Inputs minute by minute and what the boxes measured while recorded."""

    rows: list[RecordedRow]
    ranges_c: list[tuple[float, float]]  # lowest and highest, one pair per board seed

    def fits(self, plan: ProfilePlan) -> bool:
        """Return whether every box met both ends, and the fan blew often enough."""
        ends = all(
            abs(seen - wanted) <= TOLERANCE_K
            for pair in self.ranges_c
            for seen, wanted in zip(pair, plan.range_c, strict=True)
        )
        return ends and sum(row.fan_on for row in self.rows) >= plan.fan_minutes


class _Hand:
    """Switches heater and fan at random, within the plan."""

    def __init__(self, plan: ProfilePlan, seed: int) -> None:
        self._plan, self._rng = plan, random.Random(seed)
        self._duty, self._heater_min = 0.0, 0  # what holds, and minutes it holds on
        self._fan, self._fan_min = 1, 0

    def inputs(self, temps: Sequence[float]) -> tuple[float, int]:
        """Duty and fan of the coming minute, seeing the temperature of each box [degC]."""
        low, high = min(temps), max(temps)
        self._heater_min -= 1
        self._fan_min -= 1
        if self._fan and self._fan_min < 0:
            self._fan, self._fan_min = 0, self._rng.randint(*self._plan.still) - 1
        elif not self._fan and self._fan_min < 0 and self._duty > 0.0 and low >= self._plan.fan_from_c:
            self._fan, self._fan_min = 1, self._rng.randint(*self._plan.blowing) - 1
        if self._duty > 0.0 and (self._heater_min < 0 or (high >= self._plan.turn_c[1] and not self._fan)):
            self._duty, self._heater_min = 0.0, self._rng.randint(*self._plan.resting) - 1
        elif self._duty == 0.0 and (self._heater_min < 0 or low <= self._plan.turn_c[0]):
            self._duty, self._heater_min = self._draw_duty(), self._rng.randint(*self._plan.heating) - 1
        return self._duty, self._fan

    def _draw_duty(self) -> float:
        low, high = (round(20 * duty) for duty in self._plan.duty)
        return self._rng.randint(low, high) / 20


def path_of(profile: int) -> Path:
    """Return the file of test profile 1, 2 or 3."""
    return FOLDER / f"test_{profile}.csv"


def draw(plan: ProfilePlan, seed: int) -> ProfileCandidate:
    """Draw a candidate: the lead-in at one duty, then heater and fan by
    `_Hand`; the last row with all off.
    """

    def readings() -> list[float]:
        # The loop averages some samples, which leaves little of the sensor's noise.
        return [box.truth()["temp_sensor_c"] + bias_k for box in boxes]

    hand = _Hand(plan, seed)
    parameters, effects = load()
    bias_k = effects.sensor_bias * parameters.sensors.air_bias_k
    boxes = [Chamber(parameters, effects, board) for board in plan.board_seeds]
    rows: list[RecordedRow] = []
    seen: list[list[float]] = []
    for minute in range(LEAD_IN_MIN + RECORDED_MIN):
        inputs = (plan.lead_in_duty, 0)
        if minute >= LEAD_IN_MIN:
            seen.append(readings())
            inputs = hand.inputs(seen[-1])
        rows.append(RecordedRow(SAMPLE_S * minute, *inputs))
        for box in boxes:
            drive(box, SAMPLE_S, rows[-1])
    seen.append(readings())
    rows.append(RecordedRow(SAMPLE_S * len(rows), 0.0, 0))
    return ProfileCandidate(rows, [(min(temps), max(temps)) for temps in zip(*seen, strict=True)])


def main() -> None:
    """Write every profile: the first candidate that fits."""
    for profile, plan in enumerate(PLANS, start=1):
        seed = next(seed for seed in itertools.count(1) if draw(plan, seed).fits(plan))
        facts = {
            "role": "profile",
            "seed": str(seed),
            "record_from_s": str(SAMPLE_S * LEAD_IN_MIN),
            "notes": f"{plan.character}; {plan.range_c[0]}..{plan.range_c[1]} degC",
        }
        candidate = draw(plan, seed)
        write(path_of(profile), facts, candidate.rows)
        print(f"{path_of(profile).name}: candidate {seed}, {candidate.ranges_c}")


if __name__ == "__main__":
    main()
