"""Scaler: the training data's mean and variance of each column, scaled to 0 and 1."""

import torch
from torch import Tensor

CONSTANT = 1e-6  # a standard deviation below this is no spread to divide by


def scaler(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of each column of `rows` [n, k], both [k]; 1 where a column is constant."""
    exact = rows.double()  # or a constant column spreads by rounding
    mean, deviation = exact.mean(dim=0), exact.std(dim=0, correction=0)
    return mean, torch.where(deviation > CONSTANT, deviation, 1.0)
