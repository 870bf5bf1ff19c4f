"""The planning problem in condensed form, and what a plan costs."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]
TRACKING_WEIGHT = 10.0  # paper, section MPC: w_T


@dataclass(frozen=True, slots=True)
class FanRules:
    """What the fan's relay allows from now on."""

    on: bool = False  # its state in the step before the first
    hold: int = 0  # steps for which it must keep that state
    min_on: int = 1  # a switch on lasts at least this long [steps]
    min_off: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """T = free + H u_h + F u_f, H and F lower triangular Toeplitz; N steps.

    free : air temperatures with every input 0, shape [N] [°C]
    heater, fan : response of the air temperature to one step of heater duty 1 / fan on, shape [N] [K]
    reference : shape [N] [°C]
    heater_weight, fan_weight : w_h, w_f; the tracking weight is 10
    heater_levels : highest heater duty allowed, in steps of 1/20
    temp_max, limit_weight : air temperatures above temp_max cost limit_weight (T - temp_max)^2 more
    """

    free: Floats
    heater: Floats
    fan: Floats
    reference: Floats
    heater_weight: float = 0.0
    fan_weight: float = 0.0
    heater_levels: int = HEATER_LEVELS
    fan_rules: FanRules = FanRules()
    temp_max: float = np.inf
    limit_weight: float = 0.0

    @property
    def horizon(self) -> int:
        """N."""
        return len(self.free)

    def temperatures(self, levels: NDArray[np.int64], fan: NDArray[np.int64]) -> Floats:
        """Air temperature after each step of plans [..., N] (heater in steps of 1/20) [°C]."""
        n = self.horizon
        return (
            self.free
            + (levels / HEATER_LEVELS) @ lower_toeplitz(self.heater, n).T
            + fan @ lower_toeplitz(self.fan, n).T
        )

    def tracking(self, temps: Floats) -> Floats:
        """Cost of each air temperature [..., N]."""
        cost: Floats = TRACKING_WEIGHT * (temps - self.reference) ** 2
        if self.limit_weight:
            cost = cost + self.limit_weight * np.maximum(temps - self.temp_max, 0.0) ** 2
        return cost

    def tracking_slope(self, temps: Floats) -> Floats:
        """Derivative of `tracking` with respect to each air temperature."""
        slope: Floats = 2.0 * TRACKING_WEIGHT * (temps - self.reference)
        if self.limit_weight:
            slope = slope + 2.0 * self.limit_weight * np.maximum(temps - self.temp_max, 0.0)
        return slope

    def cost(self, levels: NDArray[np.int64], fan: NDArray[np.int64]) -> Floats:
        """Total cost of plans [..., N]."""
        effort = self.heater_weight * (levels / HEATER_LEVELS) ** 2 + self.fan_weight * fan
        total: Floats = (self.tracking(self.temperatures(levels, fan)) + effort).sum(axis=-1)
        return total

    def shorter(self, horizon: int) -> "Problem":
        """The same problem over its first steps."""
        return replace(
            self,
            free=self.free[:horizon],
            heater=self.heater[:horizon],
            fan=self.fan[:horizon],
            reference=self.reference[:horizon],
        )


def lower_toeplitz(response: Floats, n: int) -> Floats:
    """[n, n], entry [k, j] = response[k - j] where k >= j, else 0."""
    lag = np.arange(n)[:, None] - np.arange(n)[None, :]
    return np.where(lag >= 0, response[np.maximum(lag, 0)], 0.0)


def fan_allowed(rules: FanRules, fan: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which fan plans [..., N] keep the relay's rules."""
    allowed = np.ones(fan.shape[:-1], dtype=bool)
    state = np.full(fan.shape[:-1], int(rules.on))
    hold = np.full(fan.shape[:-1], rules.hold)
    for k in range(fan.shape[-1]):
        switched = fan[..., k] != state
        allowed &= ~(switched & (hold > 0))
        after = np.where(fan[..., k] == 1, rules.min_on, rules.min_off) - 1
        hold = np.where(switched, after, np.maximum(hold - 1, 0))
        state = fan[..., k]
    return allowed
