"""State of the greenhouse over a step: overlapping regimes for blame, disjoint cells for learning noise."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.predictor import Columns
from edge.drift.kalman import off_where_unknown

WARM_K = 6.0  # above the room: about half of what full heat does with the fan on
STRONG_DUTY = 0.5
DUTY_STEP = 0.2  # a change of the heater that shows
JUST_S = 300.0  # so long after a change its transients last


class DriftRegime(NamedTuple):
    """A name, stable, and words that end "the twin disagrees, mostly ..."."""

    name: str
    words: str


REGIMES = (
    DriftRegime("all", "at all times"),  # first: what is true at all times is not blamed on a part of them
    DriftRegime("fan_on", "with the fan on"),
    DriftRegime("fan_off", "with the fan off"),
    DriftRegime("heater_on", "with the heater on"),
    DriftRegime("heater_off", "with the heater off"),
    DriftRegime("heater_strong", "with the heater at half or more"),
    DriftRegime("warm_box", f"with the box more than {WARM_K:g} K above the room"),
    DriftRegime("fan_started", "just after the fan went on"),
    DriftRegime("fan_stopped", "just after the fan went off"),
    DriftRegime("heater_raised", "just after the heater was turned up"),
    DriftRegime("heater_lowered", "just after the heater was turned down"),
)
WORDS = {regime.name: regime.words for regime in REGIMES}
CELLS = 4  # heater on or off, fan on or off


class StepSituation(NamedTuple):
    """The situation of the step that ends at the newest row, known before its end was measured."""

    regimes: NDArray[np.bool_]  # [len(REGIMES)]
    cell: int


def situation(history: Columns, step_s: float) -> StepSituation:
    """From at least two rows; inputs that are not known count as off."""
    rows = 1 + max(1, round(JUST_S / step_s))  # now, and those before
    duty = off_where_unknown(history["heater_duty"][-1 - rows : -1])
    fan = off_where_unknown(history["fan_on"][-1 - rows : -1]) > 0.0
    heated, blown = bool(duty[-1] > 0.0), bool(fan[-1])
    found = (
        True,
        blown,
        not blown,
        heated,
        not heated,
        duty[-1] >= STRONG_DUTY,
        history["temp_air"][-2] - history["temp_ambient"][-2] > WARM_K,
        blown and not fan.all(),
        not blown and fan.any(),
        duty[-1] - duty.min() >= DUTY_STEP,
        duty.max() - duty[-1] >= DUTY_STEP,
    )
    return StepSituation(np.array(found, dtype=np.bool_), 2 * heated + blown)
