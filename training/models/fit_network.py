"""The one training loop: Adam on the MSE of the scaled target, early stopping, the best weights kept."""

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor, nn
from tqdm import tqdm

from edge.core.errors import DataError

Predict = Callable[[Tensor], Tensor]  # features of a batch -> scaled target
Note = Callable[[str, float, int], None]  # name, value, epoch


@dataclass(slots=True)
class EarlyStopping:
    """Counts epochs without progress.

    min_delta : what the loss must fall by, below the last that counted, to count as progress; here the loss
        is the MSE of the scaled target (variance 1 in the training data), the paper doesn't say
    tolerance : epochs without progress after which training stops
    """

    min_delta: float
    tolerance: int
    counted: float = math.inf
    waited: int = 0

    def is_over(self, loss: float) -> bool:
        """Return True at the epoch at which training stops. A NaN loss is not progress."""
        if loss < self.counted - self.min_delta:
            self.counted, self.waited = loss, 0
        else:
            self.waited += 1
        return self.waited >= self.tolerance


class NetworkSettings(Protocol):
    """Settings of a model that the loop needs."""

    @property
    def epochs(self) -> int:
        """Most passes over the training pairs; early stopping may end the training sooner."""
        ...

    @property
    def learning_rate(self) -> float:
        """Step size of Adam, the same in every epoch."""
        ...

    @property
    def batch_size(self) -> int:
        """Pairs in one gradient step; the last batch of an epoch may be smaller."""
        ...

    @property
    def min_delta(self) -> float:
        """Least fall of the validation loss that is progress, see `EarlyStopping`."""
        ...

    @property
    def tolerance(self) -> int:
        """Epochs without progress after which the training stops."""
        ...


@dataclass(frozen=True, slots=True)
class Pairs:
    """Features [n, ...] and the scaled target [n]."""

    features: Tensor
    target: Tensor


@dataclass(frozen=True, slots=True)
class Progress:
    """How a training went; losses are MSE of the scaled target."""

    epochs: int  # done
    best_epoch: int  # whose weights were kept, counted from 1
    train_loss: float  # of the best epoch, dropout active
    validation_loss: float  # of the best epoch


def make_deterministic(seed: int) -> None:
    """Make training deterministic on one machine: one thread, deterministic kernels, one seed."""
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    torch.manual_seed(seed)


def fit(
    network: nn.Module,
    predict: Predict,
    train: Pairs,
    validate: Pairs,
    settings: NetworkSettings,
    seed: int,
    log: Path | None = None,
) -> Progress:
    """Train `network` in place and leave it, in evaluation mode, with the weights of its best epoch.

    predict : the scaled prediction through `network`; seed : of the order of the batches
    log : folder for TensorBoard; None for no log, and no progress bar either
    Errors : DataError where there is nothing to learn from, or the validation loss is never a number
    """
    if not (len(train.target) and len(validate.target)):
        raise DataError("training: the runs are too short: no pair to train on or none to validate on")
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    stopping = EarlyStopping(settings.min_delta, settings.tolerance)
    # A generator of its own: what the network draws does not change the order of the rows.
    order = torch.Generator().manual_seed(seed)
    best = Progress(0, 0, math.inf, math.inf)
    weights = copy.deepcopy(network.state_dict())
    epochs = range(1, settings.epochs + 1)
    epoch = 0
    with _notes(log) as note:
        for epoch in tqdm(epochs, unit="epoch", leave=False, disable=None if log else True):
            train_loss = _one_epoch(network, predict, train, optimiser, order, settings.batch_size)
            loss = mean_squared_error(network, predict, validate)
            note("loss/train", train_loss, epoch)
            note("loss/validate", loss, epoch)
            if loss < best.validation_loss:
                best = Progress(epoch, epoch, train_loss, loss)
                weights = copy.deepcopy(network.state_dict())
            if stopping.is_over(loss):
                break
    if not best.epochs:
        raise DataError(f"training: the validation loss was no number in {epoch} epochs")
    network.load_state_dict(weights)
    network.eval()
    return Progress(epoch, best.best_epoch, best.train_loss, best.validation_loss)


def mean_squared_error(network: nn.Module, predict: Predict, pairs: Pairs) -> float:
    """MSE of the scaled target without dropout."""
    network.eval()
    with torch.no_grad():
        return float(nn.functional.mse_loss(predict(pairs.features), pairs.target))


def _one_epoch(
    network: nn.Module,
    predict: Predict,
    pairs: Pairs,
    optimiser: torch.optim.Optimizer,
    order: torch.Generator,
    batch_size: int,
) -> float:
    network.train()
    shuffled = torch.randperm(len(pairs.target), generator=order)
    total = 0.0
    for rows in shuffled.split(batch_size):
        loss = nn.functional.mse_loss(predict(pairs.features[rows]), pairs.target[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        total += float(loss.detach()) * len(rows)
    return total / len(pairs.target)


@contextmanager
def _notes(log: Path | None) -> Iterator[Note]:
    """Yield the sink of the losses: TensorBoard, or none."""
    if log is None:
        yield lambda name, value, epoch: None
        return
    from torch.utils.tensorboard import SummaryWriter  # takes a second to import

    with SummaryWriter(log) as writer:
        yield writer.add_scalar
