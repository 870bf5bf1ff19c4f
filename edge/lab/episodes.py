"""Drawn episodes: reference, room and light over time, and the behaviour of an air sensor.

The training of policies (`training.rl.episodes`) draws its references and rooms by the same functions.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EpisodeSettings:
    """Ranges that are drawn from, uniformly; times in steps of a minute."""

    steps: int = 240
    reference_c: tuple[float, float] = (22.0, 35.0)
    above_room_k: float = 0.5  # a reference below this over the room can't be held by any action
    hold_steps: tuple[int, int] = (10, 90)
    ramp_steps: tuple[int, int] = (10, 60)
    ramp_share: float = 0.4  # of the changes; the others are steps
    ambient_c: tuple[float, float] = (17.0, 25.0)
    ambient_wander_k: float = 0.5  # sd of the room about its mean
    ambient_steps: float = 60.0  # how long it remembers


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor of an air temperature that the loop has averaged over samples.

    quantisation_k : step of its readings, 0 for none
    """

    noise_sd_k: float = 0.03
    quantisation_k: float = 0.1

    def shows(self, air: Floats, rng: np.random.Generator) -> Floats:
        """Measurements of `air` [°C], same shape."""
        noisy = air + rng.normal(0.0, self.noise_sd_k, air.shape)
        if self.quantisation_k == 0.0:
            return noisy
        return np.round(noisy / self.quantisation_k) * self.quantisation_k


def draw_reference(rng: np.random.Generator, settings: EpisodeSettings, ambient_c: float) -> Floats:
    """Levels that hold, with steps and ramps between them, [steps] [°C]."""
    low, high = settings.reference_c
    low = min(max(low, ambient_c + settings.above_room_k), high)
    values = [rng.uniform(low, high)]
    while len(values) < settings.steps:
        values += [values[-1]] * int(rng.integers(*settings.hold_steps))
        target = rng.uniform(low, high)
        if rng.random() < settings.ramp_share:
            values += list(np.linspace(values[-1], target, int(rng.integers(*settings.ramp_steps))))
        values.append(target)
    return np.array(values[: settings.steps])


def draw_ambient(rng: np.random.Generator, settings: EpisodeSettings) -> Floats:
    """Draw the room's temperature: it wanders slowly about a mean, [steps + 1] [°C]."""
    keep = np.exp(-1.0 / settings.ambient_steps)
    pushes = rng.normal(0.0, settings.ambient_wander_k * np.sqrt(1.0 - keep**2), settings.steps + 1)
    wander = np.empty_like(pushes)
    last = rng.normal(0.0, settings.ambient_wander_k)
    for k, push in enumerate(pushes):
        last = wander[k] = keep * last + push
    return rng.uniform(*settings.ambient_c) + wander


def draw_light(rng: np.random.Generator, settings: EpisodeSettings) -> Floats:
    """Draw a lamp that is on and off by turns, [steps + 1], 0 or 1."""
    on = bool(rng.integers(2))
    values: list[float] = []
    while len(values) <= settings.steps:
        values += [float(on)] * int(rng.integers(*settings.hold_steps))
        on = not on
    return np.array(values[: settings.steps + 1])
