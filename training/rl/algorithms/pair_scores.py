"""A duty and the sign of a fan as scores of all actions: the highest is the nearest one."""

import torch
from torch import Tensor, nn

from edge.core.names import HEATER_LEVELS
from edge.models.policy_actions import LEVELS
from training.rl.algorithms.algorithm import with_last

HALFWAY = (torch.arange(1, LEVELS, dtype=torch.float64) - 0.5) / HEATER_LEVELS  # duties between two levels


@torch.no_grad()
def pair_scores(hidden: nn.Sequential, pair: nn.Linear, thresholds: Tensor) -> nn.Sequential:
    """Return the network whose highest output is the action of a pair (m, f).

    hidden : layers before the pair, [B, features] -> [B, H]; pair : [B, H] -> (m, f) [B, 2]
    thresholds : of m between two neighbouring levels, rising [HEATER_LEVELS]; the fan is on above f = 0

    Level l is chosen while m lies between the thresholds t_l and t_l+1. The lines l m - (t_1 + ... + t_l)
    cross there, so the highest line is that of the chosen level. The scores are linear in m, hence one layer.
    """
    slope = torch.arange(LEVELS, dtype=torch.float64) / HEATER_LEVELS
    offset = torch.cat([torch.zeros(1, dtype=torch.float64), thresholds.cumsum(0)]) / HEATER_LEVELS
    # By the pair [ACTIONS, 2]: every level with the fan off, then with the fan on.
    by_pair = torch.stack([slope.repeat(2), torch.tensor([-0.5, 0.5]).repeat_interleave(LEVELS)], dim=1)
    bias = by_pair @ pair.bias.double() - offset.repeat(2)
    return with_last(hidden, by_pair @ pair.weight.double(), bias)
