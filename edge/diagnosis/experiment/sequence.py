"""Short experiments as arrays of heater, fan and light, within the limits of safety."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import SafetySettings
from edge.core.names import HEATER_LEVELS, HEATER_MAX_W
from edge.safety.memory import HEAT_BUCKET_S
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
HOUR_S, DAY_S = 3600.0, 86400.0
ROUNDING = 1e-9
DURATIONS_S = (3600.0, 7200.0, 10800.0)
FEWEST_ROWS = 12
MARGIN_K = 2.0  # below the temperature at which safety steps in
LEVELS = np.array([1.0, 0.75, 0.5, 0.35, 0.2, 0.1, 0.05])  # of the duty
STAIRS = np.array([0.4, 0.8, 0.2, 1.0, 0.6])  # of the level
HEATER_HOLDS_S, FAN_HOLDS_S = (180.0, 1200.0), (120.0, 360.0)  # shortest and longest state of a random input
LATER_S = 3600.0  # an experiment begins so long after the last row
SEED = 7  # the same data give the same experiment


@dataclass(frozen=True, slots=True)
class ExperimentLimits:
    """Limits of a designed experiment.

    safety : of the rig; step_s : its control step, on which a profile's rows stand
    heater_w : at full duty, for the caps on energy
    """

    safety: SafetySettings = field(default_factory=SafetySettings)
    step_s: float = 60.0
    heater_w: float = HEATER_MAX_W

    @property
    def highest_c(self) -> float:
        """Highest air temperature that a rival may predict."""
        return self.safety.temp_air_max_c - MARGIN_K

    def row_s(self, sample_s: float) -> float:
        """Return the length of a plan's row: whole control steps, at least a twin's step [s]."""
        return float(self.step_s * np.ceil(sample_s / self.step_s - ROUNDING))

    def fan_rows(self, row_s: float) -> int:
        """Return the fewest rows between two switches of the fan."""
        apart_s = HOUR_S / (self.safety.fan_switches_hour_max - 1)
        longest_s = max(self.safety.fan_min_on_s, self.safety.fan_min_off_s, apart_s)
        return max(1, int(np.ceil(longest_s / row_s - ROUNDING)))

    def duty(self, wanted: Floats) -> Floats:
        """Return the next lower duties that may be sent."""
        most = np.minimum(wanted, self.safety.heater_max_duty)
        return np.asarray(np.floor(most * HEATER_LEVELS + ROUNDING) / HEATER_LEVELS)

    def limit_rise(self, duty: Floats, row_s: float) -> Floats:
        """Return duties [B, N] after the limit on their rise, which begins at 0."""
        found, ramp = np.empty_like(duty), np.zeros(len(duty))
        for k in range(duty.shape[1]):
            ramp = np.minimum(duty[:, k], ramp + self.safety.heater_rise_per_s * row_s)
            found[:, k] = self.duty(ramp)
        return found

    def within_energy(self, duty: Floats, row_s: float) -> NDArray[np.bool_]:
        """Return which of the duties [B, N] keep the caps on energy, [B]."""
        found = np.ones(len(duty), dtype=bool)
        caps = ((HOUR_S, self.safety.energy_hour_max_wh), (DAY_S, self.safety.energy_day_max_wh))
        for window_s, cap_wh in caps:
            if cap_wh < self.heater_w * window_s / HOUR_S:
                # Safety counts heat in buckets, and the coming step's too.
                rows = round((window_s + HEAT_BUCKET_S) / row_s) + 1
                sums = np.pad(np.cumsum(duty, axis=1), ((0, 0), (rows, 0)))
                most = (sums[:, rows:] - sums[:, :-rows]).max(axis=1)
                found &= most * self.heater_w * row_s / HOUR_S <= cap_wh
        return found


@dataclass(frozen=True, slots=True, eq=False)
class SequenceInputs:
    """B experiments over N rows, off after their ends.

    kinds : what each is, in words; wanted : duty as a profile has it; duty : as safety sends it
    within : whether a row belongs to the experiment; all [B, N]
    """

    row_s: float
    kinds: tuple[str, ...]
    wanted: Floats
    duty: Floats
    fan: Floats
    light: Floats
    within: NDArray[np.bool_]

    def choose(self, which: NDArray[np.intp]) -> "SequenceInputs":
        """Return the experiments that `which` selects."""
        names = ("wanted", "duty", "fan", "light", "within")
        columns = {name: getattr(self, name)[which] for name in names}
        return replace(self, kinds=tuple(self.kinds[i] for i in which), **columns)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Conditions that stay the same during an experiment.

    room_c : its temperature [°C]; guessed : whether nobody measured it
    columns : further ones as constants; utc : begin of an experiment, None where not known
    has_fan, has_light : whether an experiment may switch them; fan_on : of a fan that it may not switch
    """

    room_c: float
    guessed: bool
    columns: Mapping[str, float]
    utc: float | None
    has_fan: bool
    has_light: bool
    fan_on: float

    def record(self, inputs: SequenceInputs, start_c: float) -> RunBatch:
        """Return the inputs as runs of which only the first temperature is known."""
        shape = inputs.fan.shape
        temp = np.full((shape[0], shape[1] + 1), np.nan)
        temp[:, 0] = start_c
        conditions = {name: np.full(shape, value) for name, value in self.columns.items()}
        if "light" in conditions:
            conditions["light"] = inputs.light
        if self.utc is not None:
            conditions["utc"] = np.broadcast_to(self.utc + inputs.row_s * np.arange(shape[1]), shape)
        return RunBatch(temp, inputs.duty, inputs.fan, np.full(shape, self.room_c), conditions)


def surroundings(runs: RunBatch, guessed: bool, has_fan: bool = True) -> Surroundings:
    """Return the conditions at the end of the runs, and the inputs that these show to exist.

    A fan that runs in every row has no switch, as far as is known; a light that is never lit may be none.
    """
    conditions = dict(runs.conditions)
    utc, light = conditions.pop("utc", None), conditions.get("light")
    always_on = bool((runs.fan[runs.measured] > 0.0).all())
    return Surroundings(
        float(np.mean(runs.ambient[-1])),
        guessed,
        {name: 0.0 if name == "door_open" else float(np.mean(own)) for name, own in conditions.items()},
        None if utc is None else float(utc.max()) + LATER_S,
        has_fan and not always_on,
        light is not None and bool(light.max() > 0.0),
        float(has_fan and always_on),
    )


def candidates(limits: ExperimentLimits, around: Surroundings, row_s: float) -> SequenceInputs | None:
    """Return all experiments that keep the limits on heat and relay, None without one."""
    found: list[tuple[str, Floats]] = []
    levels = [level for level in np.unique(limits.duty(LEVELS)) if level > 0.0]
    for rows in {int(duration_s / row_s + ROUNDING) for duration_s in DURATIONS_S}:
        for kind, heater, fan, light in _families(rows, limits, around, row_s):
            found += [(kind, np.array([level * heater, fan, light, np.ones(rows)])) for level in levels]
    if not found:
        return None
    longest = max(columns.shape[1] for _, columns in found)
    padded = [np.pad(columns, ((0, 0), (0, longest - columns.shape[1]))) for _, columns in found]
    wanted, fan, light, within = np.stack(padded, axis=1)
    wanted = limits.duty(wanted)
    duty, light = limits.limit_rise(wanted, row_s), np.minimum(light, limits.safety.led_max)
    kinds = tuple(kind for kind, _ in found)
    inputs = SequenceInputs(row_s, kinds, wanted, duty, fan, light, within > 0.0)
    passed = np.flatnonzero(limits.within_energy(duty, row_s))
    return inputs.choose(passed) if len(passed) else None


def _families(
    rows: int, limits: ExperimentLimits, around: Surroundings, row_s: float
) -> Iterator[tuple[str, Floats, Floats, Floats]]:
    """Yield kinds of experiments: words, and heater, fan and light by row [0..1]. The light is as yet off."""
    if rows < FEWEST_ROWS:
        return
    steady, off, still = np.ones(rows), np.zeros(rows), np.full(rows, around.fan_on)
    stairs = STAIRS[np.arange(rows) * len(STAIRS) // rows]
    low, high = (max(1, round(hold_s / row_s)) for hold_s in HEATER_HOLDS_S)
    yield "a staircase of five heater levels", stairs, still, off
    yield "a pseudo-random heater sequence", _switching(rows, low, high), still, off
    yield "a warm-up and a long coast", np.where(np.arange(rows) < rows // 3, 1.0, 0.0), still, off
    if around.has_fan:
        least, warm = limits.fan_rows(row_s), rows // 4
        low, high = (max(least, round(hold_s / row_s)) for hold_s in FAN_HOLDS_S)
        blown = np.append(np.zeros(warm), _switching(rows - warm, low, high))
        yield "a pseudo-random fan sequence in a warm box", steady, blown, off
    if around.has_light:
        lit = _switching(rows, rows // 6, rows // 6)
        yield "the light on and off with the heater steady", steady, still, lit


def _switching(rows: int, low: int, high: int) -> Floats:
    """Return 1 and 0 in turn, each for a pseudo-random number of rows."""
    lengths = np.random.default_rng(SEED).integers(low, high, rows, endpoint=True)
    return np.asarray(np.repeat((np.arange(rows) + 1.0) % 2.0, lengths)[:rows])
