"""Ours: the best plan in the model, imitated (DAgger, Ross et al., AISTATS 2011).

The teacher is MPC-Twin's own search over the twin of the training model, for the present reference, which is
all that a policy sees. The teacher knows the model's state. Its pupil drives the boxes by the observation
alone, and learns the teacher's answers in the states that the pupil has come to.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, mse_loss

from edge.controllers.mixed_integer.problem import PlanningProblem
from edge.controllers.mpc_twin import CLASH_WEIGHT, LEAST_WEIGHT
from edge.controllers.twin_plan.beam import PlanStart, relay, search
from edge.controllers.twin_plan.linear_step import LinearStep, linear_step
from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.models.policy_actions import LEVELS, duties_and_fans
from edge.models.policy_observation import FEATURES
from edge.twin.model import BoxTwin
from training.rl.algorithms.algorithm import falling_rate
from training.rl.boxes import BoxesNow, EpisodeBoxes, World

Actions = NDArray[np.int64]
HALFWAY = (torch.arange(1, LEVELS, dtype=torch.float64) - 0.5) / HEATER_LEVELS  # duties between two levels


@dataclass(frozen=True, slots=True)
class DaggerSettings:
    """Rounds of an episode in every box; the teacher drives in the first round, the pupil in all others."""

    steps: int = 100_000  # of the environment, in whole rounds and no more
    boxes: int = 16
    hidden: tuple[int, ...] = (128, 128)
    asked_every: int = 10  # steps of the pupil's between two questions to the teacher
    horizon: int = 12  # of the teacher's plans [steps]
    width: int = 60  # of its beam [nodes]
    passes: int = 6  # over all answers so far, after each round
    batch: int = 256
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-4  # reached in a straight line
    duty_weight: float = 10.0  # of the squared error of the duty beside the fan's cross entropy


class Teacher:
    """The first action of the best plan. Errors: DataError for a model without a linear twin to plan in"""

    def __init__(self, twins: Sequence[BoxTwin], settings: DaggerSettings) -> None:
        if not twins or any(twin.signals.bends or twin.needs for twin in twins):
            raise DataError("DAgger: plans in a linear twin: choose --model ham, pbm, or such a twin file")
        self._steps = [_linear(twin) for twin in twins]
        self._settings = settings

    def actions(self, now: BoxesNow) -> Actions:
        """Return the best action of each box, [B]."""
        return np.array([self._action(now, box) for box in range(len(now.ambient))])

    def _action(self, now: BoxesNow, box: int) -> int:
        steps, fan = self._settings.horizon, int(now.fan[box])
        nothing = np.zeros(steps)  # the twin gives the response
        goal = PlanningProblem(
            free=nothing,
            heater=nothing,
            fan=nothing,
            reference=np.full(steps, now.reference[box]),
            heater_weight=LEAST_WEIGHT,
            fan_weight=LEAST_WEIGHT,
            clash_weight=CLASH_WEIGHT,
            fan_rules=relay(bool(fan), 0, 1, 1, steps),
        )
        level = round(float(now.duty[box]) * HEATER_LEVELS)
        start = PlanStart(now.state[box], 0.0, float(now.ambient[box]), level, fan)
        plan = search(self._steps[now.variant[box]], goal, start, self._settings.width).plan
        return int(plan.levels[0]) + LEVELS * int(plan.fan[0])


def _linear(twin: BoxTwin) -> LinearStep:
    """Return the twin's step; that of a linear one is the same at every state."""
    return linear_step(twin, np.zeros(len(twin.states)), 0.0, {})


def learn(world: World, seed: int, settings: DaggerSettings) -> nn.Sequential:
    """Learn from the teacher's answers. Errors: DataError for a model without a linear twin"""
    torch.set_num_threads(1)  # the same sums in the same order, on every machine of a kind
    torch.manual_seed(seed)
    teacher = Teacher(world.model.twins, settings)
    boxes = EpisodeBoxes(world, settings.boxes, np.random.default_rng(seed))
    pupil = _Pupil(settings)
    rounds = settings.steps // (settings.boxes * world.episodes.steps)
    for each in range(rounds):
        _round(boxes, teacher, pupil, each)
        pupil.study(1.0 - each / rounds)
    return pupil.network()


def _round(boxes: EpisodeBoxes, teacher: Teacher, pupil: "_Pupil", number: int) -> None:
    """Drive an episode in every box and note the teacher's answers."""
    observation, every = boxes.reset().astype(np.float32), pupil.settings.asked_every
    for k in range(boxes.world.episodes.steps):
        actions = None if number == 0 else pupil.act(observation)
        if actions is None or k % every == number % every:
            answers = teacher.actions(boxes.now())
            pupil.note(observation, answers)
            actions = answers if actions is None else actions
        observation = boxes.step(actions).observation.astype(np.float32)


class _Pupil:
    """A network of a duty and a fan, and all answers so far."""

    def __init__(self, settings: DaggerSettings) -> None:
        self.settings = settings
        sizes = (len(FEATURES), *settings.hidden)
        layers = [(nn.Linear(size, out), nn.ReLU()) for size, out in pairwise(sizes)]
        self._hidden = nn.Sequential(*(layer for pair in layers for layer in pair))
        self._pair = nn.Linear(sizes[-1], 2)
        self._both = nn.Sequential(*self._hidden, self._pair)
        self._rate = falling_rate(settings.learning_rate, settings.final_learning_rate)
        self._optimizer = torch.optim.Adam(self._both.parameters(), fused=True)
        self._seen: list[NDArray[np.float32]] = []
        self._answers: list[Actions] = []

    def network(self) -> nn.Sequential:
        """Return the scores of all actions."""
        return pair_scores(self._hidden, self._pair)

    @torch.no_grad()
    def act(self, observation: NDArray[np.float32]) -> Actions:
        """Return the actions nearest to its duties and fans, [B]."""
        return np.asarray(self.network()(torch.from_numpy(observation)).argmax(dim=1).numpy())

    def note(self, observation: NDArray[np.float32], answers: Actions) -> None:
        """Take in the teacher's answers [B] to the observations [B, features]."""
        self._seen.append(observation)
        self._answers.append(answers)

    def study(self, left: float) -> None:
        """Fit all answers so far. left : share of the training that is left, for the learning rate"""
        settings = self.settings
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate(left)
        seen = torch.from_numpy(np.concatenate(self._seen))
        duty, fan = (
            torch.from_numpy(column).float() for column in duties_and_fans(np.concatenate(self._answers))
        )
        for _ in range(settings.passes):
            for rows in torch.randperm(len(seen)).split(settings.batch):
                m, f = self._both(seen[rows]).T
                loss = settings.duty_weight * mse_loss(m, duty[rows])
                loss = loss + binary_cross_entropy_with_logits(f, fan[rows])
                self._optimizer.zero_grad()
                loss.backward()
                self._optimizer.step()


@torch.no_grad()
def pair_scores(hidden: nn.Sequential, pair: nn.Linear) -> nn.Sequential:
    """Return the network whose highest output is the action of a pair (m, f).

    hidden : layers before the pair, [B, features] -> [B, H]; pair : [B, H] -> (m, f) [B, 2]; the fan is on
        above f = 0

    Level l is chosen while the duty m lies between the thresholds t_l and t_l+1, halfway to its neighbours.
    The lines l m - (t_1 + ... + t_l) cross there, so the highest line is that of the chosen level. The scores
    are linear in m, hence one layer.
    """
    slope = torch.arange(LEVELS, dtype=torch.float64) / HEATER_LEVELS
    offset = torch.cat([torch.zeros(1, dtype=torch.float64), HALFWAY.cumsum(0)]) / HEATER_LEVELS
    # By the pair [ACTIONS, 2]: every level with the fan off, then with the fan on.
    by_pair = torch.stack([slope.repeat(2), torch.tensor([-0.5, 0.5]).repeat_interleave(LEVELS)], dim=1)
    return nn.Sequential(
        *hidden,
        _linear_layer(by_pair @ pair.weight.double(), by_pair @ pair.bias.double() - offset.repeat(2)),
    )


def _linear_layer(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    layer.weight.copy_(weight)
    layer.bias.copy_(bias)
    return layer
