"""The planning problem in condensed form, and what a plan costs."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
TRACKING_WEIGHT = 10.0  # paper, section MPC: w_T


@dataclass(frozen=True, slots=True)
class FanRules:
    """The switching rules of the fan's relay from now on."""

    on: bool = False  # its state in the step before the first
    hold: int = 0  # steps for which it must keep that state
    min_on: int = 1  # a switch on lasts at least this long [steps]
    min_off: int = 1

    @property
    def holds(self) -> int:
        """How many different holds there can be: 1 where the relay may switch at every step."""
        return max(self.hold, self.min_on - 1, self.min_off - 1) + 1

    def next_hold(self, before: Ints, hold: Ints, after: Ints) -> tuple[Ints, NDArray[np.bool_]]:
        """Return the steps to hold after a change from `before` to `after`, and
        whether the change is allowed.
        """
        switched = before != after
        begun = np.where(after == 1, self.min_on, self.min_off) - 1
        return np.where(switched, begun, np.maximum(hold - 1, 0)), ~(switched & (hold > 0))


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Inputs over the horizon; `cost` is all they cost."""

    levels: Ints  # heater duty in steps of 1/20, [N]
    fan: NDArray[Any]  # share of each step for which it is on, [N]; 0 and 1 where a planner knows no parts
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanningProblem:
    """T = free + H u_h + F u_f, H and F lower triangular Toeplitz; N steps to plan, then M of tail.

    The tail is a terminal cost: steps after the plan whose inputs are settled beforehand and stand in `free`.

    free : air temperatures with every planned input 0, shape [N + M] [°C]
    heater, fan : response of the air temperature to one step of heater duty 1 / fan on, shape [N + M] [K]
    reference : shape [N + M] [°C]
    tail : M
    heater_weight, fan_weight : w_h, w_f; the tracking weight is 10
    heater_levels : highest heater duty allowed, in steps of 1/20
    temp_max, limit_weight : air temperatures above temp_max cost limit_weight (T - temp_max)^2 more
    low, high, band_weight : air temperatures outside low..high [N + M] cost band_weight times the square
        more; None: nowhere
    clash_weight : cost of a step of full heat while the fan runs
    rest : steps in which heater and fan are to be off. Only `twin_plan` plans with these five
    """

    free: Floats
    heater: Floats
    fan: Floats
    reference: Floats
    tail: int = 0
    heater_weight: float = 0.0
    fan_weight: float = 0.0
    heater_levels: int = HEATER_LEVELS
    fan_rules: FanRules = field(default=FanRules())
    temp_max: float = np.inf
    limit_weight: float = 0.0
    low: Floats | None = None
    high: Floats | None = None
    band_weight: float = 0.0
    clash_weight: float = 0.0
    rest: range = range(0)

    def __post_init__(self) -> None:
        """Refuse NaN, with which no comparison in the search would hold. Raises : DataError"""
        for name in ("free", "heater", "fan", "reference"):
            if not np.isfinite(getattr(self, name)).all():
                raise DataError(f"planning problem: {name}: a value is no number")

    @property
    def horizon(self) -> int:
        """N."""
        return len(self.free) - self.tail

    def temperatures(self, levels: Ints, fan: Ints) -> Floats:
        """Air temperature after each step of plans [..., N], the tail's too: [..., N + M] [°C]."""
        n = self.horizon
        heated: Floats = (levels / HEATER_LEVELS) @ lower_toeplitz(self.heater, n).T
        return self.free + heated + fan @ lower_toeplitz(self.fan, n).T

    def tracking(self, temps: Floats, steps: int | slice = slice(None)) -> Floats:
        """Cost of air temperatures [..., steps]."""
        cost: Floats = TRACKING_WEIGHT * (temps - self.reference[steps]) ** 2
        if self.limit_weight:
            cost = cost + self.limit_weight * np.maximum(temps - self.temp_max, 0.0) ** 2
        if self.low is not None and self.high is not None:
            outside = np.maximum(np.maximum(temps - self.high[steps], self.low[steps] - temps), 0.0)
            cost = cost + self.band_weight * outside**2
        return cost

    def tracking_slope(self, temps: Floats) -> Floats:
        """Return the derivative of `tracking` with respect to each air temperature [N + M]."""
        slope: Floats = 2.0 * TRACKING_WEIGHT * (temps - self.reference)
        if self.limit_weight:
            slope = slope + 2.0 * self.limit_weight * np.maximum(temps - self.temp_max, 0.0)
        return slope

    def effort(self, levels: Ints, fan: NDArray[Any]) -> Floats:
        """Cost of inputs, one by one."""
        duty = levels / HEATER_LEVELS
        effort: Floats = self.heater_weight * duty**2 + self.fan_weight * fan
        return effort + self.clash_weight * duty * fan if self.clash_weight else effort

    def cost(self, levels: Ints, fan: Ints) -> Floats:
        """Total cost of plans [..., N]."""
        return self.cost_at(self.temperatures(levels, fan), levels, fan)

    def cost_at(self, temps: Floats, levels: Ints, fan: Ints) -> Floats:
        """Total cost of plans [..., N] with the air temperatures [..., N + M]."""
        tracking = self.tracking(temps)
        return np.asarray(tracking.sum(axis=-1) + self.effort(levels, fan).sum(axis=-1))

    def allows(self, levels: Ints, fan: Ints) -> NDArray[np.bool_]:
        """Which plans [..., N] keep the heater's bounds and the relay's rules."""
        allowed = ((levels >= 0) & (levels <= self.heater_levels)).all(axis=-1)
        allowed &= ((fan == 0) | (fan == 1)).all(axis=-1)
        state = np.full(fan.shape[:-1], int(self.fan_rules.on))
        hold = np.full(fan.shape[:-1], self.fan_rules.hold)
        for k in range(self.horizon):
            hold, fine = self.fan_rules.next_hold(state, hold, fan[..., k])
            allowed &= fine
            state = fan[..., k]
        return np.asarray(allowed)


def lower_toeplitz(response: Floats, n: int) -> Floats:
    """[len(response), n], entry [k, j] = response[k - j] where k >= j, else 0."""
    lag = np.arange(len(response))[:, None] - np.arange(n)[None, :]
    return np.where(lag >= 0, response[np.maximum(lag, 0)], 0.0)
