"""How much of the measurements no twin can know: found with the twin, by maximum likelihood."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.innovations import FilterInput, NoiseLevels, log_likelihoods
from edge.diagnosis.trial import FittedTwin, Trial, start_of, start_spread
from edge.twin.linearise import EnsembleRun, LinearSteps, linearise, responses
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile

Floats = NDArray[np.float64]
Step = Mapping[str, float]  # factors of levels
USUAL_HEAT = 0.01  # unknown heat where the file does not say, share of the heater's: most are within 5 times
USUAL_HEAT_LOG_SD = 1.6
USUAL_POWER_SHARE = 0.01  # mains from run to run where the file does not say
USUAL_TAU_S, TAU_RANGE_S = 600.0, (90.0, 7200.0)  # in the paper's box
SENSOR_RANGE_K = (0.005, 2.0)
HEAT_RANGE = (0.0002, 5.0)  # share of the heater's
RANGES = {"sensor_k": SENSOR_RANGE_K, "room_k": SENSOR_RANGE_K}
MORE_HEAT, HEAT_NATS = 1.5, 10.0  # times the declared heat, and how sure that it is more
MOST_HEAT = 0.04  # share that nobody would look for a cause of, where the file declares none
FIRST_FACTOR, NEAR_FACTOR, LAST_FACTOR = 3.0, 1.4, 1.15  # of the steps in which levels are sought
PASSES = 10
LONGEST_STEP = 1.5  # powers of the factor
CLOSE = 1.8  # a factor over which a likelihood is a parabola
LEAST_BEND = 1e-3  # nats, of a level that hardly matters
WORTH_A_STEP = 0.05  # nats


def first_levels(file: TwinFile, runs: RunBatch) -> NoiseLevels:
    """Return the noise that the file declares, and first values for the rest."""
    step_k = file.sensor.get("quantisation_k") or 0.0
    sensor_k = file.sensor.get("noise_sd_k")
    heat_w = file.nuisance.get("heat_noise_sd_w")
    power = file.nuisance.get("heater_power_run_sd")
    reading_k = _curl(runs.temp[:, 1:], runs) if sensor_k is None else np.hypot(sensor_k, step_k / 12**0.5)
    return NoiseLevels(
        sensor_k=float(np.clip(reading_k, max(SENSOR_RANGE_K[0], step_k / 12**0.5), SENSOR_RANGE_K[1])),
        room_k=float(np.clip(_curl(runs.ambient, runs), *SENSOR_RANGE_K)),
        heat_w=max(
            USUAL_HEAT * _heater_w(file) if heat_w is None else heat_w, HEAT_RANGE[0] * _heater_w(file)
        ),
        heat_tau_s=USUAL_TAU_S * file.scale.time,
        power_share=USUAL_POWER_SHARE if power is None else power,
    )


def _heater_w(file: TwinFile) -> float:
    """Full power of the heater: what is much heat and what is little in a box [W]."""
    return max(file.values()["geometry", "heater_max_w"].value, 1e-3)


def _curl(values: Floats, runs: RunBatch) -> float:
    """Noise of a slow signal by its second differences, in rows in which no input changed."""
    still = np.ones(runs.duty.shape, dtype=bool)
    for column in (runs.duty, runs.fan):
        changed = np.diff(column, axis=1, prepend=column[:, :1]) != 0.0
        for rows in range(4):
            still[:, rows:] &= ~changed[:, : changed.shape[1] - rows]
    second = values[:, 2:] - 2.0 * values[:, 1:-1] + values[:, :-2]
    chosen = second[still[:, 2:] & np.isfinite(second) & np.isfinite(runs.temp[:, 3:])]
    return float(np.sqrt(np.mean(chosen**2) / 6.0)) if len(chosen) > 10 else 0.0


def find_levels(
    found: Sequence[FittedTwin], file: TwinFile, runs: RunBatch, factor: float = FIRST_FACTOR
) -> list[Trial]:
    """Fit the trials again, each from its best values and with the likeliest noise.

    factor : of the first steps
    """
    free = _free(file, runs)
    measured = runs.measured
    sought = [_LevelSearch(_Base(item, runs), item.trial.levels, free, factor) for item in found]
    while moving := [item for item in sought if free and item.passes < PASSES]:
        tried = [[_change(item.centre, step, file) for step in item.steps] for item in moving]
        scores = _scores([item.base for item in moving], tried, file, measured)
        for item, levels, own in zip(moving, tried, scores, strict=True):
            item.take(levels, own, file)
    return [
        replace(item.trial, file=item.file, free=item.free, levels=own.levels)
        for item, own in zip(found, sought, strict=True)
    ]


def _free(file: TwinFile, runs: RunBatch) -> tuple[str, ...]:
    names = ["heat_tau_s"]
    if (runs.ambient != runs.ambient[:, :1]).any():  # a room that was read, not one constant a run
        names.append("room_k")
    if file.nuisance.get("heat_noise_sd_w") is None:
        names.append("heat_w")
    if file.sensor.get("noise_sd_k") is None:
        names.append("sensor_k")
    return tuple(names)


def _change(levels: NoiseLevels, step: Step, file: TwinFile) -> NoiseLevels:
    heater_w = _heater_w(file)
    ranges = {
        **RANGES,
        "heat_w": (HEAT_RANGE[0] * heater_w, HEAT_RANGE[1] * heater_w),
        "heat_tau_s": (TAU_RANGE_S[0] * file.scale.time, TAU_RANGE_S[1] * file.scale.time),
    }
    values = {name: float(np.clip(getattr(levels, name) * by, *ranges[name])) for name, by in step.items()}
    return replace(levels, **values)


class _Base:
    """A fitted twin's steps, spread of its starts, and what its free run leaves, its terms at their sizes."""

    def __init__(self, found: FittedTwin, runs: RunBatch) -> None:
        self.twin = found.file.twin()
        self.steps: LinearSteps = linearise(self.twin, runs)
        terms = [term.response(self.steps) for term in found.trial.nuisances]
        self.spread = start_spread(self.twin, runs)
        shown = responses([EnsembleRun(self.steps, start_of(self.twin, runs), self.steps.driven), *terms])
        for i, term in enumerate(found.trial.nuisances):
            shown[0] += found.sizes[i] * (term.shape.T if term.of_reading else shown[1 + i])
        self.error = np.nan_to_num(runs.temp[:, 1:]) - shown[0]


class _LevelSearch:
    """Levels on their way: Newton steps on log levels, by differences either side that get smaller.

    Heat that wanders as far in a row, but for longer, is looked at too: of all pairs of levels only those
    two make a ridge.
    """

    def __init__(self, base: "_Base", levels: NoiseLevels, free: Sequence[str], factor: float) -> None:
        self.base, self.levels, self.centre, self._free = base, levels, levels, free
        self.passes, self._best, self._factor = 0, -np.inf, factor
        self._along = {"heat_w", "heat_tau_s"} <= set(free)

    @property
    def steps(self) -> list[Step]:
        """Those to be tried next: none, either way in each level, and along the ridge."""
        by = self._factor
        found: list[Step] = [{}, *({name: factor} for name in self._free for factor in (by, 1.0 / by))]
        if self._along:
            found += [{"heat_w": float(np.sqrt(factor)), "heat_tau_s": factor} for factor in (by, 1.0 / by)]
        return found

    def take(self, tried: Sequence[NoiseLevels], scores: Floats, file: TwinFile) -> None:
        """Go on from the best place, or from where it must be by their differences."""
        top = int(np.argmax(scores))
        if scores[top] > self._best:
            self.levels, self._best = tried[top], float(scores[top])
        move, promised = self._newton(tried, scores)
        self.passes += 1
        if self._factor <= CLOSE and scores[0] > self._best - WORTH_A_STEP and promised < WORTH_A_STEP:
            self.passes = PASSES  # arrived
        ahead = scores[0] + promised > self._best
        steps = dict(zip(self._free, self._factor**move, strict=True))
        self.centre = _change(self.centre, steps, file) if ahead else self.levels
        if np.abs(move).max() < LONGEST_STEP:  # else there is a way to go
            self._factor = max(float(np.sqrt(self._factor)), LAST_FACTOR)

    def _newton(self, tried: Sequence[NoiseLevels], scores: Floats) -> tuple[Floats, float]:
        """Return the Newton step to the maximum, in powers of the factor, and the expected gain [nats]."""
        count = len(self._free)
        up, down = scores[1 : 2 * count : 2], scores[2 : 2 * count + 1 : 2]
        slope, bend = 0.5 * (up - down), np.diag(up + down - 2.0 * scores[0])
        if self._along:
            heat, tau = self._free.index("heat_w"), self._free.index("heat_tau_s")
            both = scores[-2:].sum() - 2.0 * scores[0] - 0.25 * bend[heat, heat] - bend[tau, tau]
            bend[heat, tau] = bend[tau, heat] = both
        pairs = zip(self._free, tried[1 : 2 * count : 2], tried[2 : 2 * count + 1 : 2], strict=True)
        wide = 0.99 * self._factor**2  # else a range ends between the two
        whole = [getattr(above, name) >= wide * getattr(below, name) for name, above, below in pairs]
        slope, bend = np.where(whole, slope, 0.0), np.where(np.outer(whole, whole), bend, 0.0)
        curvature, axes = np.linalg.eigh(bend)
        move = axes @ (axes.T @ slope / np.maximum(np.abs(curvature), LEAST_BEND))
        move = np.clip(move, -LONGEST_STEP, LONGEST_STEP)
        return move, float(slope @ move + 0.5 * move @ bend @ move)


def _scores(
    bases: list[_Base], tried: list[list[NoiseLevels]], file: TwinFile, measured: NDArray[np.bool_]
) -> list[Floats]:
    """Log likelihood of each of the levels of each base, with the prior of an undeclared heat."""
    filtered = [
        FilterInput(base.steps, levels, base.spread, base.twin.step_s)
        for base, own in zip(bases, tried, strict=True)
        for levels in own
    ]
    errors = np.stack([base.error for base, own in zip(bases, tried, strict=True) for _ in own])
    likelihood = log_likelihoods(filtered, measured, errors)
    every = [levels for own in tried for levels in own]
    likelihood += np.array([level_prior(levels, file) for levels in every])
    ends = np.cumsum([len(own) for own in tried])[:-1]
    return list(np.split(likelihood, ends))


def level_prior(levels: NoiseLevels, file: TwinFile) -> float:
    """Log prior of the noise that the file does not declare."""
    if file.nuisance.get("heat_noise_sd_w") is not None:
        return 0.0
    return float(-0.5 * (np.log(levels.heat_w / (USUAL_HEAT * _heater_w(file))) / USUAL_HEAT_LOG_SD) ** 2)


def unexplained_heat(found: FittedTwin, file: TwinFile, runs: RunBatch) -> bool:
    """Return whether the unknown heat exceeds the declared one, or the usual one where none is declared."""
    declared = file.nuisance.get("heat_noise_sd_w")
    usual_w = MOST_HEAT * _heater_w(file) if declared is None else declared
    open_file = replace(file, nuisance={**file.nuisance, "heat_noise_sd_w": None})
    trial = find_levels([found], open_file, runs)[0]
    if trial.levels.heat_w <= MORE_HEAT * usual_w:
        return False
    base = _Base(found, runs)
    bounded = replace(trial.levels, heat_w=MORE_HEAT * usual_w)
    scores = _scores([base], [[trial.levels, bounded]], file, runs.measured)[0]
    return bool(scores[0] - scores[1] > HEAT_NATS)
