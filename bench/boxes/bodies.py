"""Bodies that are heated and felt: a drawn box or its twin, as many columns at once as asked.

All columns of a body have the same room, sun and noise, and each its own heater and fan.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.boxes.box import Box
from bench.boxes.facts import BoxFacts
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
STEP_S, SAMPLE_S = 60.0, 10.0
SAMPLES = round(STEP_S / SAMPLE_S)


@dataclass(frozen=True, slots=True)
class StepSamples:
    """A step's samples, oldest first. air : [SAMPLES, M]; room : [SAMPLES], None without a sensor [°C]"""

    air: Floats
    room: Floats | None


class Body(Protocol):
    """Air that is heated and felt."""

    def pass_step(self, duty: Floats, fan: Floats) -> StepSamples:
        """Let a step pass with these inputs [M], 0..1."""
        ...


class BoxBody:
    """A drawn box. seed : of weather and noise; count : M"""

    def __init__(self, facts: BoxFacts, seed: int, count: int) -> None:
        self._box = Box(facts, seed)
        self._states = np.repeat(self._box.state, count, axis=0)

    def pass_step(self, duty: Floats, fan: Floats) -> StepSamples:
        """As `Body`."""
        box, air, room = self._box, [], []
        for part in range(SAMPLES):
            blows = ((part + 0.5) / SAMPLES < fan).astype(np.float64)
            self._states = box.physics.step(self._states, box.time_s, SAMPLE_S, duty, blows)
            box.time_s += SAMPLE_S
            sensed = []
            for column in range(len(duty)):
                box.state = self._states[column : column + 1]
                sensed.append(box.sense())
            air.append([shown["temp_air_c"] for shown in sensed])
            room.append(sensed[0].get("temp_ambient_c", np.nan))
        return StepSamples(np.array(air), None if box.facts.room_sensor is None else np.array(room))


class TwinBody:
    """A twin in a room that does not change.

    noise_sd_k : of its sensor, which has to move; heat : of the heater's, 1 for all
    """

    def __init__(
        self,
        twin: BoxTwin,
        room_c: float,
        has_room: bool,
        noise_sd_k: float,
        count: int,
        heat: float = 1.0,
    ) -> None:
        self._twin, self._room_c, self._has_room, self._heat = twin, room_c, has_room, heat
        self._states = np.repeat(at_rest(twin, room_c, room_c)[None], count, axis=0)
        self._before = Commands(np.zeros((count, 1)), np.zeros((count, 1)))
        self._given = {name: np.zeros(1) for name in twin.needs}
        self._rng, self._noise_sd_k = np.random.default_rng(1), noise_sd_k

    def pass_step(self, duty: Floats, fan: Floats) -> StepSamples:
        """As `Body`."""
        now = Commands(self._heat * duty[:, None], fan[:, None])
        march = self._twin.march(now, self._room_c, conditions=self._given, before=self._before)
        first = self._states[:, 0]
        self._states, self._before = march.step(0, self._states), now
        air = np.linspace(first, self._states[:, 0], SAMPLES + 1)[1:]
        noise = self._noise_sd_k * self._rng.standard_normal((SAMPLES, 1))
        return StepSamples(air + noise, np.full(SAMPLES, self._room_c) if self._has_room else None)
