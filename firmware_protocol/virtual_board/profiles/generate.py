"""Writes the 15 predefined input sequences: `python -m firmware_protocol.virtual_board.profiles.generate`.

Each is drawn at random (segments of constant duty and fan) and kept when the default chamber's measured
temperature ends up in the band the sequence is meant for: so the set spans the paper's training range
(21.8 to 36.9 degC, Table "Model experiment scenarios") and has its low part (up to 29.7 degC) as whole runs.
"""

import random
from dataclasses import dataclass

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.profiles.record import FOLDER, SAMPLE_S, RecordedRow, record, write


@dataclass(frozen=True, slots=True)
class SequencePlan:
    """The aim of one sequence."""

    minutes: int
    duties: tuple[float, float]  # lowest and highest duty that is not 0
    off_share: float  # of segments without heat
    fan_share: float  # of segments with the fan on
    hold_min: tuple[int, int]  # shortest and longest segment [min]
    peak_c: tuple[float, float]  # band of the highest measured temperature


_LOW, _MIDDLE, _HIGH = (28.0, 29.1), (30.3, 33.6), (34.5, 36.6)
PLANS = (
    SequencePlan(212, (0.10, 0.40), 0.25, 0.20, (5, 25), _LOW),
    SequencePlan(205, (0.20, 0.70), 0.50, 0.15, (3, 10), _LOW),
    SequencePlan(220, (0.05, 0.35), 0.15, 0.30, (8, 30), _LOW),
    SequencePlan(212, (0.30, 1.00), 0.65, 0.25, (2, 6), _LOW),
    SequencePlan(198, (0.10, 0.50), 0.30, 0.40, (4, 15), _LOW),
    SequencePlan(226, (0.15, 0.60), 0.45, 0.10, (5, 20), _LOW),
    SequencePlan(212, (0.05, 0.45), 0.30, 0.30, (2, 8), _LOW),
    SequencePlan(212, (0.20, 0.80), 0.35, 0.20, (5, 20), _MIDDLE),
    SequencePlan(204, (0.30, 0.70), 0.30, 0.15, (8, 25), _MIDDLE),
    SequencePlan(219, (0.40, 1.00), 0.55, 0.20, (3, 12), _MIDDLE),
    SequencePlan(212, (0.10, 0.90), 0.30, 0.30, (2, 10), _MIDDLE),
    SequencePlan(216, (0.25, 0.65), 0.25, 0.25, (10, 30), _MIDDLE),
    SequencePlan(206, (0.50, 1.00), 0.30, 0.20, (5, 25), _HIGH),
    SequencePlan(214, (0.40, 0.95), 0.20, 0.10, (10, 35), _HIGH),
    SequencePlan(212, (0.60, 1.00), 0.40, 0.15, (4, 16), (36.5, 36.9)),
)


def draw(plan: SequencePlan, rng: random.Random) -> list[RecordedRow]:
    """Draw a candidate: segments of constant inputs, one row per minute, the last row with all off."""
    inputs: list[tuple[float, int]] = []
    while len(inputs) < plan.minutes:
        low, high = (round(duty * 20) for duty in plan.duties)
        duty = 0.0 if inputs and rng.random() < plan.off_share else rng.randint(low, high) / 20
        fan = int(bool(inputs) and rng.random() < plan.fan_share)
        hold = rng.randint(*plan.hold_min)
        inputs += [(duty, fan)] * (min(hold, 10) if fan else hold)
    rows = [RecordedRow(SAMPLE_S * k, *pair) for k, pair in enumerate(inputs[: plan.minutes])]
    return [*rows, RecordedRow(SAMPLE_S * plan.minutes, 0.0, 0)]


def _find(plan: SequencePlan, seed: int) -> list[RecordedRow]:
    """Find the first candidate whose measured peak lies in the plan's band."""
    rng = random.Random(seed)
    parameters, effects = load()
    while True:
        rows = draw(plan, rng)
        peak = max(row["temp_air_c"] for row in record(Chamber(parameters, effects, seed), rows))
        if plan.peak_c[0] <= peak <= plan.peak_c[1]:
            return rows


def main() -> None:
    """Write every profile beside this script."""
    for number, plan in enumerate(PLANS, start=1):
        facts = {
            "role": "profile",
            "seed": str(number),
            "notes": f"peak {plan.peak_c[0]}..{plan.peak_c[1]} degC",
        }
        write(FOLDER / f"profile_{number:02}.csv", facts, _find(plan, number))


if __name__ == "__main__":
    main()
