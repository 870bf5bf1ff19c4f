"""Rivals fitted to simulated runs without a search, and experiments designed between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.plan import PlannedExperiment, design_experiment
from edge.diagnosis.experiment.separation import RivalPair, Separation, separation
from edge.diagnosis.experiment.sequence import ExperimentLimits, surroundings
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, begun, fit_twins
from edge.diagnosis.unknowns import with_effect
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest
from tests.support.simulated_runs import NOISE, STEP_S, SimulatedNoise, coloured_noise

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]
ROOM_C = 21.0
ROWS = 120
STILL, BLOWN = np.zeros(ROWS), np.ones(ROWS)
DUTIES = np.repeat([0.1, 0.4, 0.0, 0.3, 0.5, 0.2], ROWS // 6)
ONE_DUTY = np.repeat([0.0, 0.6, 0.0, 0.6], ROWS // 4)


@dataclass(frozen=True, slots=True)
class RunInputs:
    """Inputs of one run, a value a row."""

    duty: Floats
    fan: Floats
    light: Floats | None = None


def file_of(effects: Effects, uncertain: Mapping[str, float] | None = None) -> TwinFile:
    """A file that knows these effects, exactly but for those of which it says how well."""
    rel_sd = uncertain or {}
    return TwinFile(
        effects={
            name: {key: Value(value, rel_sd=rel_sd.get(name)) for key, value in own.items()}
            for name, own in effects.items()
        },
        sensor={"quantisation_k": 0.0, "noise_sd_k": NOISE.sensor_k},
        nuisance={"heater_power_run_sd": NOISE.power_share, "heat_noise_sd_w": NOISE.heat_w},
    )


def driven(
    effects: Effects,
    inputs: Sequence[RunInputs],
    seed: int = 0,
    noise: SimulatedNoise = NOISE,
    start_c: float = ROOM_C,
) -> RunBatch:
    """Runs of a box with these effects, from rest."""
    draw = np.random.default_rng(seed)
    twin, rows = BoxTwin(Geometry(), effects, STEP_S), len(inputs[0].duty)
    duty, fan = (np.stack([getattr(item, name) for item in inputs]) for name in ("duty", "fan"))
    lit = inputs[0].light is not None
    light = {"light": np.stack([item.light for item in inputs if item.light is not None])} if lit else {}
    power = duty * (1.0 + noise.power_share * draw.standard_normal((len(duty), 1)))
    heat_w = np.stack([coloured_noise(draw, rows, noise) for _ in inputs])
    start = at_rest(twin, np.full(len(duty), start_c), np.full(len(duty), ROOM_C))
    source = heat_w / twin.system.air_capacity_j_k
    room = np.full((len(duty), rows), ROOM_C)
    shown = twin.rollout(start, power, fan, room, source=source, conditions=light)
    shown = np.concatenate([np.full((len(duty), 1), start_c), shown], axis=1)
    return RunBatch(shown + noise.sensor_k * draw.standard_normal(shown.shape), duty, fan, room, light)


def fit_runs(runs: RunBatch) -> FitRuns:
    """Runs from rest in a room that was measured, as a fit takes them."""
    unmeasured = np.zeros(len(runs.duty), dtype=bool)
    return FitRuns(runs, NOISE.sensor_k, ~unmeasured, unmeasured)


def fitted(file: TwinFile, runs: RunBatch, name: str) -> FittedTwin:
    """With one more effect, at its best."""
    starts = [begun(start) for start in with_effect(file, name)]
    return min(fit_twins(starts, fit_runs(runs), 12), key=lambda item: item.cost)


def pairs_of(names: Sequence[str]) -> list[RivalPair]:
    """Every two of these names, each as likely as another."""
    return [
        RivalPair((i, j), (names[i], names[j]), (1.0, 1.0)) for i, j in combinations(range(len(names)), 2)
    ]


def plan_of(file: TwinFile, runs: RunBatch, names: Sequence[str], has_fan: bool = True) -> Separation:
    """To separate the effects of these names."""
    models = [fitted(file, runs, name) for name in names]
    return separation(models, pairs_of(names), surroundings(runs, False, has_fan), STEP_S)


def experiment_of(
    file: TwinFile, runs: RunBatch, names: Sequence[str], limits: ExperimentLimits | None = None
) -> PlannedExperiment:
    """The experiment that is designed between these effects."""
    return design_experiment(plan_of(file, runs, names), limits or ExperimentLimits())


def as_inputs(experiment: PlannedExperiment) -> RunInputs:
    """The profile, a value a row."""
    columns = dict(experiment.profile)
    time_s = columns.pop("time_s")
    at = np.searchsorted(time_s, STEP_S * np.arange(round(time_s[-1] / STEP_S)), side="right") - 1
    light = columns["light"][at] if "light" in columns else None
    return RunInputs(columns["heater_duty"][at], columns["fan_on"][at], light)


def joined(runs: RunBatch, later: RunBatch) -> RunBatch:
    """All runs, the shorter ones filled up with what was not measured."""
    rows = max(runs.duty.shape[1], later.duty.shape[1])

    def filled(own: RunBatch) -> RunBatch:
        missing = ((0, 0), (0, rows - own.duty.shape[1]))
        columns = {name: np.pad(getattr(own, name), missing) for name in ("duty", "fan")}
        ambient = np.pad(own.ambient, missing, mode="edge")
        return replace(
            own, temp=np.pad(own.temp, missing, constant_values=np.nan), ambient=ambient, **columns
        )

    one, other = filled(runs), filled(later)
    together = (
        np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("temp", "duty", "fan", "ambient")
    )
    return RunBatch(*together)
