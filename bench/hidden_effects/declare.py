"""Declaration of the known effects in a case's twin file: some exact, some to 5 %, some open."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from numpy.random import Generator

from bench.hidden_effects.draw_readings import Sensing
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

REL_SD = 0.05
START_SD = 0.15  # of where a fit begins
LOSSES = ("wall_loss", "wall_mass", "longwave_radiation")


@dataclass(frozen=True, slots=True)
class Knowledge:
    """How well a case's values are known; of nuisances and the sensor's noise, whether they are.

    mode : all exact; all to 5 %; or to 5 % but the loss to be fitted
    """

    mode: Literal["exact", "uncertain", "to_fit"]
    nuisance: bool
    sensor_noise: bool
    day0: bool  # whether the first run's start is told


def draw_knowledge(rng: Generator, weak: bool) -> Knowledge:
    """Draw the knowledge of one case. weak : the hidden effect does less than
    5 % of the known ones, mostly exact then
    """
    odds = (0.75, 0.25, 0.0) if weak else (0.45, 0.4, 0.15)
    mode = rng.choice(["exact", "uncertain", "to_fit"], p=odds)
    return Knowledge(str(mode), *(bool(rng.random() < odds) for odds in (0.75, 0.6, 0.5)))  # type: ignore[arg-type]


def declare_twin(
    rng: Generator,
    effects: Mapping[str, Mapping[str, float]],
    knowledge: Knowledge,
    sensing: Sensing,
    nuisance: Mapping[str, float],
    day0_utc: float,
) -> TwinFile:
    """Return the twin file that the workflow is given."""
    return TwinFile(
        effects={
            name: {key: _value(rng, name, key, item, knowledge) for key, item in own.items()}
            for name, own in effects.items()
        },
        sensor=_sensor(sensing, knowledge.sensor_noise),
        nuisance=dict(nuisance) if knowledge.nuisance else dict.fromkeys(nuisance),
        day0_utc=day0_utc if knowledge.day0 else None,
    )


def exact(
    effects: Mapping[str, Mapping[str, float]],
    sensing: Sensing,
    nuisance: Mapping[str, float],
    day0_utc: float | None,
) -> TwinFile:
    """Return the truth in the library's terms."""
    return TwinFile(
        effects={name: {key: Value(item) for key, item in own.items()} for name, own in effects.items()},
        sensor=_sensor(sensing, True),
        nuisance=dict(nuisance),
        day0_utc=day0_utc,
    )


def _sensor(sensing: Sensing, is_known: bool) -> dict[str, float | None]:
    return {"quantisation_k": sensing.step_k, "noise_sd_k": round(sensing.noise_k, 4) if is_known else None}


def _value(rng: Generator, effect: str, key: str, true: float, knowledge: Knowledge) -> Value:
    """One value, off from the truth by as much as its uncertainty says."""
    off = float(rng.normal())
    parameter = EFFECTS[effect].parameter(key)

    def inside(value: float) -> float:
        return float(f"{min(max(value, parameter.low), parameter.high):.6g}")

    if knowledge.mode == "exact":
        return Value(inside(true))
    if knowledge.mode == "to_fit" and effect in LOSSES:
        return Value(inside(true * (1.0 + START_SD * off)), fit=True)
    return Value(inside(true / (1.0 + REL_SD * off)), rel_sd=REL_SD)
