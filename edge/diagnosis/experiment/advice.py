"""Advice for a person beyond heater and fan: calibrate a value, let the ambient vary, check an effect by
hand.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.families import ExperimentScores
from edge.diagnosis.experiment.rivals import RIVAL_NATS
from edge.diagnosis.experiment.separation import Separation
from edge.twin.effects.library import EFFECTS
from edge.twin.effects.named import FLOW_CHECK, POWER_CHECK
from edge.twin.twin_file import Place

GEOMETRY: Mapping[str, str] = {
    "heater_max_w": POWER_CHECK,
    "fan_max_m3_s": FLOW_CHECK,
    "volume_m3": "a tape measure",
    "air_density_kg_m3": "a barometer",
    "air_heat_capacity_j_kg_k": "a hygrometer",
}


def checks(names: Iterable[str]) -> tuple[str, ...]:
    """Return the independent checks of these effects, each once."""
    return tuple(dict.fromkeys(check for name in names if (check := EFFECTS[name].check)))


def calibration(place: Place) -> str:
    """How a value is calibrated."""
    check = GEOMETRY.get(place[1], "") if place[0] == "geometry" else EFFECTS[place[1]].check
    return check or "a measurement of its own"


Floats = NDArray[np.float64]
SWING_K = 3.0
WORTH_NATS = 3.0  # that a person's trouble must bring
SETTLED_NATS = 10.0  # log odds that leave no question


@dataclass(frozen=True, slots=True)
class ValueCalibration:
    """A value that is known to some percent, calibrated first.

    alone : expected log odds of the pair that is hardest to tell by the runs so far and this value [nat]
    with_experiment : after the experiment; None where there is none
    """

    place: Place
    alone: float
    with_experiment: float | None

    @property
    def name(self) -> str:
        """As the twin file has it: `fan_effectiveness.eps_f`, `geometry.heater_max_w`."""
        return ".".join(self.place[1:] if self.place[0] == "effects" else self.place)


def calibrate_first(
    found: Separation, pairs: NDArray[np.bool_], chosen: ExperimentScores | None, expected: float
) -> ValueCalibration | None:
    """Return the value whose calibration helps most, None where the
    experiment suffices or the help is too small.

    pairs : those that the advice is for; expected : log odds without a calibration
    """
    if expected >= SETTLED_NATS:
        return None
    best = None
    for place in _uncertain(found):
        alone = float(found.by_calibration(place)[pairs].min())
        if best is None or alone > best.alone:
            both = None
            if chosen is not None:
                both = float(found.log_odds(chosen.cool.inputs, exact=place)[pairs].min())
            best = ValueCalibration(place, alone, both)
    if best is None or max(best.alone, best.with_experiment or 0.0) < expected + WORTH_NATS:
        return None
    return best


def _uncertain(found: Separation) -> list[Place]:
    """Values that are known to some percent, and that all models share."""
    values = found.models[0].file.values()
    shared = set.intersection(*({item.place for item in model.free} for model in found.models))
    return sorted(place for place in shared if values[place].rel_sd is not None)


def swung(found: Separation, tried: ExperimentScores, pairs: NDArray[np.bool_]) -> float | None:
    """Return the expected log odds if the ambient warms by 3 K during the
    experiment, None where that helps too little.

    pairs : those that are hard to tell without
    """
    around = replace(found.around, swing_k=SWING_K)
    still = tried.log_odds[pairs].min(axis=0).max()
    moved = float(replace(found, around=around).log_odds(tried.cool.inputs)[pairs].min(axis=0).max())
    return moved if moved >= max(RIVAL_NATS, 2.0 * still) else None
