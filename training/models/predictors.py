"""The networks behind the one seam of every predictor, in eager torch: for evaluation and as a reference."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from edge.core.predictor import Columns, Floats, Predictor
from training.models.ham import GuardedHamNet, HamNet
from training.models.window_network import COLUMNS, WINDOW, WindowNet

Network = WindowNet | HamNet | GuardedHamNet
Advance = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]  # state, ambient, duty, fan -> state


class WindowPredictor:
    """A network of a window fed back: each prediction enters the window of the next."""

    version, step_s, rows_needed = "eager", 60.0, WINDOW

    def __init__(self, network: WindowNet) -> None:
        self.name = network.kind
        self._network = network.eval()

    @torch.no_grad()
    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """As `edge.core.predictor.Predictor.rollout`."""
        inputs = torch.from_numpy(controls).float()
        window = _tail(history, COLUMNS, WINDOW).repeat(len(inputs), 1, 1)
        temps = []
        for k in range(inputs.shape[1]):
            window[:, -1, 1:] = inputs[:, k]
            following = self._network(window)
            temps.append(following)
            coming = torch.cat([following[:, None], torch.zeros(len(inputs), 2)], dim=1)
            window = torch.cat([window[:, 1:], coming[:, None]], dim=1)
        return _stack(temps)


class HamPredictor:
    """The paper's HAM; its only state is the air temperature."""

    name, version, step_s, rows_needed = "ham", "eager", 60.0, 1

    def __init__(self, network: HamNet) -> None:
        self._network = network.eval()

    @torch.no_grad()
    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """As `edge.core.predictor.Predictor.rollout`."""
        now = torch.full((len(controls),), float(history["temp_air"][-1]))
        return _stack(_advance(self._network, now, controls, ahead))


class GuardedHamPredictor:
    """Our HAM; its state comes out of a window of measurements."""

    name, version, step_s, rows_needed = "ham_guarded", "eager", 60.0, WINDOW

    def __init__(self, network: GuardedHamNet) -> None:
        self._network = network.eval()

    @torch.no_grad()
    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """As `edge.core.predictor.Predictor.rollout`."""
        names = ("temp_air", "temp_ambient", "heater_duty", "fan_on")
        window = _tail(history, names, WINDOW)
        start = self._network.start(*(window[None, :, i] for i in range(len(names))))
        states = _advance(self._network, start.repeat(len(controls), 1), controls, ahead)
        return _stack([state[:, 0] for state in states])


def eager(network: Network) -> Predictor:
    """Return the predictor of any trained network; its `name` is the kind of the exported file."""
    match network:
        case WindowNet():
            return WindowPredictor(network)
        case HamNet():
            return HamPredictor(network)
        case GuardedHamNet():
            return GuardedHamPredictor(network)


def _advance(step: Advance, state: Tensor, controls: Floats, ahead: Mapping[str, Floats]) -> list[Tensor]:
    """Return the state after each control."""
    inputs = torch.from_numpy(controls).float()
    ambient = torch.from_numpy(ahead["temp_ambient"]).float()
    states = []
    for k in range(inputs.shape[1]):
        state = step(state, ambient[k].repeat(len(inputs)), inputs[:, k, 0], inputs[:, k, 1])
        states.append(state)
    return states


def _tail(history: Columns, names: tuple[str, ...], rows: int) -> Tensor:
    """Return the last rows of these columns, [rows, names]."""
    return torch.from_numpy(np.stack([history[name][-rows:] for name in names], axis=-1)).float()


def _stack(temps: list[Tensor]) -> Floats:
    return torch.stack(temps, dim=1).double().numpy()
