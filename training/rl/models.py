"""Models that step many boxes at once, one call each; an environment knows nothing else of a model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from edge.twin.model import BoxTwin
from edge.twin.warm_start import PastColumns, state_now
from training.models.ham import GuardedHamNet
from training.models.window_network import LstmNet

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Window:
    """Measured rows of B boxes, the last of them now: its duty and fan are not decided yet.

    temp, ambient [°C], duty, fan : [B, training.models.window_network.WINDOW]
    """

    temp: Floats
    ambient: Floats
    duty: Floats
    fan: Floats


class StepModel(Protocol):
    """Boxes side by side. `variants` of the model differ in their parameters; each box is one of them."""

    name: str
    sha256: str
    variants: int
    twins: Sequence[BoxTwin]  # the physics of each variant, none in a model without

    def start(self, window: Window, variant: Indices) -> Floats:
        """States [B, ...] at the windows' last row."""
        ...

    def advance(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, variant: Indices
    ) -> tuple[Floats, Floats]:
        """States and air temperatures [B] [°C] a step later; ambient [°C], duty, fan : [B]."""
        ...


class TwinModel:
    """Physics: one or more twins of the same effects.

    Errors : DataError from `start` and `advance` where a twin needs more columns than there are
    """

    def __init__(self, twins: Sequence[BoxTwin], name: str = "twin") -> None:
        self.name, self.sha256, self.variants = name, twins[0].sha256, len(twins)
        self.twins = twins

    def start(self, window: Window, variant: Indices) -> Floats:
        """As `StepModel.start`: found by each twin's Kalman filter."""
        states = [
            state_now(self.twins[which], PastColumns(*(column[i] for column in _columns(window))))
            for i, which in enumerate(variant)
        ]
        return np.array(states)

    def advance(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, variant: Indices
    ) -> tuple[Floats, Floats]:
        """As `StepModel.advance`."""
        after = self.step(state, ambient, duty, fan, np.zeros(len(state)), variant)
        return after, after[:, 0]

    def step(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, source: Floats, variant: Indices
    ) -> Floats:
        """Return the states a step later with a source of heat [K/s]."""
        if self.variants == 1:
            return self.twins[0].advance(state, ambient, duty, fan, source)
        after = np.empty_like(state)
        for which in np.unique(variant):
            rows = variant == which
            after[rows] = self.twins[which].advance(
                state[rows], ambient[rows], duty[rows], fan[rows], source[rows]
            )
        return after


class HamModel:
    """The guarded hybrid: its network corrects whichever twin a box is, as it was trained to correct one."""

    def __init__(self, network: GuardedHamNet, physics: TwinModel, sha256: str) -> None:
        self.name, self.sha256, self.variants = "ham", sha256, physics.variants
        self._network, self._physics, self.twins = network.eval(), physics, physics.twins

    def start(self, window: Window, variant: Indices) -> Floats:
        """As `StepModel.start`."""
        return self._physics.start(window, variant)

    @torch.no_grad()
    def advance(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, variant: Indices
    ) -> tuple[Floats, Floats]:
        """As `StepModel.advance`: solved without the source, then with the one that the network gives."""
        inputs = np.stack([ambient, duty, fan], axis=1)
        bare = self._physics.step(state, ambient, duty, fan, np.zeros(len(state)), variant)
        here = torch.from_numpy(np.column_stack([state[:, 0], inputs])).float()
        features = torch.from_numpy(np.column_stack([bare[:, 0], inputs])).float()
        network = self._network
        source = network.trust(here) * network.scaled_source(features) * network.source_scale
        after = self._physics.step(state, ambient, duty, fan, source.double().numpy(), variant)
        return after, after[:, 0]


class LstmModel:
    """The LSTM fed back over its window [B, WINDOW, 3]; it knows nothing of the room."""

    variants = 1
    twins: Sequence[BoxTwin] = ()

    def __init__(self, network: LstmNet, sha256: str) -> None:
        self.name, self.sha256 = "lstm", sha256
        self._network = network.eval()

    def start(self, window: Window, variant: Indices) -> Floats:
        """As `StepModel.start`."""
        return np.stack([window.temp, window.duty, window.fan], axis=2)

    @torch.no_grad()
    def advance(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, variant: Indices
    ) -> tuple[Floats, Floats]:
        """As `StepModel.advance`."""
        now = state.copy()
        now[:, -1, 1], now[:, -1, 2] = duty, fan
        air = self._network(torch.from_numpy(now).float()).double().numpy()
        coming = np.column_stack([air, np.zeros((len(air), 2))])
        return np.concatenate([now[:, 1:], coming[:, None]], axis=1), air


def _columns(window: Window) -> tuple[Floats, Floats, Floats, Floats]:
    return window.temp, window.ambient, window.duty, window.fan
