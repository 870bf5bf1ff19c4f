"""The seam of a learning algorithm: a world in, a network of scores out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from torch import nn

from training.rl.boxes import World

Learn = Callable[[World, int, Any], nn.Sequential]


@dataclass(frozen=True, slots=True)
class Algorithm:
    """A row of the registry.

    settings : those in use, a frozen dataclass of JSON values; `steps` of it counts environment steps
    learn : world, seed and settings -> linear layers with ReLU between, [B, features] -> [B, ACTIONS]. The
        policy takes the action of the highest output
    """

    settings: Any
    learn: Learn


def learn_by(
    make_agent: Callable[[World, int, Any], BaseAlgorithm],
    network_of: Callable[[Any], nn.Sequential],
) -> Learn:
    """Return the `learn` of an algorithm of stable-baselines3.

    make_agent : world, seed and settings -> an untrained agent
    network_of : a trained agent -> the network of its deterministic choice
    """

    def learn(world: World, seed: int, settings: Any) -> nn.Sequential:
        return network_of(train(make_agent(world, seed, settings), settings.steps))

    return learn


def train(agent: BaseAlgorithm, steps: int) -> BaseAlgorithm:
    """Return the agent after so many environment steps."""
    torch.set_num_threads(1)  # the same sums in the same order, on every machine of a kind
    agent.set_logger(Logger(None, []))  # without one each run leaves a folder in /tmp
    return agent.learn(steps)


def falling_rate(first: float, last: float) -> Callable[[float], float]:
    """Return a learning rate that falls in a straight line, by the share of the training that is left."""
    return lambda left: last + (first - last) * left
