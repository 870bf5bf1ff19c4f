"""The twin under inputs that stay: the heat that holds a temperature, the final temperature, the way there.

The balance is linear but for heat that bends with the air's temperature. That is exact in a final state; on
the way to a target its secant between start and target stands for it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.discretisation import exponential
from edge.twin.model import DAY_S, BoxTwin
from edge.twin.network import AIR, ROOM, LinearSystem

Floats = NDArray[np.float64]
MOMENT_S = 1.0  # resolution of a time to a target
DOUBLINGS = 20  # of MOMENT_S, so that a way of up to 12 days is seen
ROUNDS, CLOSE_K, CLOSE_SHARE = 60, 1e-5, 1e-6  # of the searches for a final temperature and a command
NARROW_K = 0.05  # least distance of a secant's ends
DUTIES = 201  # at which a heater's power is looked up
UNSEEN, UNSEEN_TIMES = "unseen", 5.0  # body that a fit did not see; its time constant in lengths of the rows
FIRST_K, FARTHEST_K = 2.0, 1e4  # steps from the room to beyond a final temperature


@dataclass(frozen=True, slots=True)
class ConstantInputs:
    """Inputs beside the heater's.

    room_c : as the rig's sensor shows it [°C]; fan : speed as share of the full flow, 0..1
    columns : values of the further columns that the twin needs, `utc` among them
    power : times the twin's heater
    more_w : heat into the air beside the twin's, by the air's temperature
    seen_s : of the rows that the twin was fitted on, for these two
    stored : share of the losses which are none, but heat into a body so slow that the fit did not see it warm
    lost : share of the heat into bodies of the twin which they pass on to the room; less in a quick body, for
        which the rows would have shown it
    """

    room_c: float
    fan: float = 0.0
    columns: Mapping[str, float] = field(default_factory=dict)
    power: float = 1.0
    more_w: Callable[[float], float] | None = None
    seen_s: float = 0.0
    stored: float = 0.0
    lost: float = 0.0


class SteadyTwin:
    """A twin, its balance for these inputs put together once. Errors: DataError for a missing column"""

    def __init__(self, twin: BoxTwin, inputs: ConstantInputs) -> None:
        system, signals = _system(twin, inputs), twin.signals
        if missing := sorted(set(twin.needs) - set(inputs.columns)):
            raise DataError(f"{missing[0]}: missing, the twin's {twin.needs[missing[0]]} needs it")
        day = 0.0
        if signals.ageing_per_day != 0.0:
            if twin.day0_utc is None:
                raise DataError("day0_utc: missing, the twin counts days from it")
            day = float(signals.days(np.array((inputs.columns["utc"] - twin.day0_utc) / DAY_S)))
        self._signals, self._air = signals, system.states.index(AIR)
        self._rates = system.rates + inputs.fan * system.fan_rates + day * system.other_rates[1]
        self._drive = system.drive + inputs.fan * system.fan_drive + day * system.other_drive[1]
        self._per_w = self._drive[:, 2] / system.air_capacity_j_k
        self._more_w, self._bends = inputs.more_w, signals.bends or inputs.more_w is not None
        self._drive[:, 0] *= inputs.power
        self._power = inputs.power
        self._room = np.array(inputs.room_c)
        self._columns = {name: np.array(value) for name, value in inputs.columns.items()}
        self._columns |= {"fan_on": np.array(inputs.fan), "heater_duty": np.array(0.0)}
        still_w = signals.heat_w(np.zeros(()), self._room, self._columns, by_temp=False)
        self._given = self._drive[:, 1] * float(signals.room(self._room)) + self._per_w * float(still_w)

    def duty_to_hold(self, temp_c: float) -> float:
        """Return the duty that holds the air; below 0 where it had to be cooled, above 1 out of reach."""
        share, duties = self.share_to_hold(temp_c), np.linspace(0.0, 1.0, DUTIES)
        shares = self._signals.duty(duties)
        if 0.0 < share < shares[-1]:
            return float(np.interp(share, shares, duties))
        return share if share <= 0.0 else share / float(shares[-1])

    def share_to_hold(self, temp_c: float) -> float:
        """Return the share of the heater's power that holds the air; below 0 where it had to be cooled."""
        share = self._share(temp_c, 0.0)
        for _ in range(ROUNDS if self._bends else 0):  # heat may depend on the command as well
            before, share = share, self._share(temp_c, min(max(share, 0.0), 1.0))
            if abs(share - before) < CLOSE_SHARE:
                break
        return share

    def final_c(self, duty: float) -> float:
        """Return the air after all has settled at a duty [°C], infinite where too little leaves the box.

        Errors : DataError for a heater that warms nothing
        """
        if not self._drive[:, 0].any():
            raise DataError("the twin's heater does not warm the air")
        given = float(self._signals.duty(np.array(duty)))
        near = float(self._room)
        missed = self._share(near, duty) - given
        step = -math.copysign(FIRST_K, missed)
        far, other = near, missed
        while other * missed > 0.0:  # heat that bends may take the same command at several temperatures
            near, missed, far, step = far, other, far + step, 2.0 * step
            other = self._share(far, duty) - given
            if not abs(step) < FARTHEST_K:
                return math.copysign(math.inf, step)
        for _ in range(ROUNDS):  # regula falsi, Illinois: Dowell & Jarratt 1971, BIT 11
            if abs(far - near) < CLOSE_K or other == 0.0:
                return far
            between = far - other * (far - near) / (other - missed)
            here = self._share(between, duty) - given
            if here * other < 0.0:
                near, missed = far, other
            else:
                missed *= 0.5
            far, other = between, here
        return far

    def rest_at(self, temp_c: float) -> Floats:
        """Return the state [n] at rest with the heat, or the cold, that holds the air at `temp_c`."""
        return np.concatenate([[temp_c], self._at_rest(temp_c, 0.0)[:-1]])

    def time_s(self, states: Floats, target_c: float, duty: float, dead_s: float = 0.0) -> float:
        """Return the time until the sensor shows the target, infinite where never.

        states : [n], from which the air goes one way at these inputs, so that halving finds the moment
        dead_s : until the inputs act
        """
        sign = 1.0 if target_c >= states[0] else -1.0
        if target_c == states[0]:
            return 0.0
        slope, level = self._secant(float(states[0]), target_c, duty)
        rates = self._rates.copy()
        rates[:, self._air] += slope * self._per_w
        driven = self._given + level * self._per_w
        driven += self._drive[:, 0] * float(self._signals.duty(np.array(duty)))
        state, integral = exponential(rates, MOMENT_S)
        steps = [(state, integral @ driven)]
        for _ in range(DOUBLINGS):
            matrix, added = steps[-1]
            steps.append((matrix @ matrix, matrix @ added + added))
        passed = 0
        for k in range(DOUBLINGS, -1, -1):
            later = steps[k][0] @ states + steps[k][1]
            if sign * later[0] < sign * target_c:
                states, passed = later, passed + 2**k
        is_never = passed == 2 ** (DOUBLINGS + 1) - 1
        return math.inf if is_never else (passed + 0.5) * MOMENT_S + dead_s

    def _share(self, temp_c: float, duty: float) -> float:
        return float(self._at_rest(temp_c, duty)[-1])

    def _at_rest(self, temp_c: float, duty: float) -> Floats:
        """Return the hidden states and the share of the heater's power, with the air held at `temp_c`."""
        balance = np.column_stack([self._rates[:, 1:], self._drive[:, 0]])
        known = -(self._rates[:, 0] * temp_c + self._given + self._per_w * self._bent_w(temp_c, duty))
        scale = np.abs(balance).max(axis=1)  # rows in one size, as W/s is far from K/s
        scale[scale == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(balance / scale[:, None], known / scale, rcond=None)[0])

    def _bent_w(self, temp_c: float, duty: float) -> float:
        columns = {**self._columns, "heater_duty": np.array(self._power * duty)}
        more_w = self._more_w(temp_c) if self._more_w else 0.0
        return more_w + float(self._signals.heat_w(np.array(temp_c), self._room, columns, by_temp=True))

    def _secant(self, start_c: float, target_c: float, duty: float) -> tuple[float, float]:
        """Return slope [W/K] and level [W] of the heat that bends."""
        if not self._bends:
            return 0.0, 0.0
        low, high = sorted((start_c, target_c))
        high = max(high, low + NARROW_K)
        low_w, high_w = (self._bent_w(temp, duty) for temp in (low, high))
        slope = (high_w - low_w) / (high - low)
        return slope, low_w - slope * low


def _system(twin: BoxTwin, inputs: ConstantInputs) -> LinearSystem:
    """Return the twin's system with what passes through its bodies, and with the body that was not seen."""
    if not inputs.seen_s > 0.0:
        return twin.system
    network = twin.network()
    outward = [path for path in network.paths if ROOM in path[:2]]
    for name, capacity_j_k in network.nodes.items():
        if not any(name in path[:2] for path in outward):
            w_k = sum(path.off_w_k for path in network.paths if name in path[:2])
            lost = inputs.lost * math.exp(-inputs.seen_s * w_k / capacity_j_k)
            network.connect(name, ROOM, w_k * lost / (1.0 - lost))
    stored_w_k = 0.0
    for path in outward if inputs.stored > 0.0 else ():
        if path.fan_w_k >= 0.0 and path.off_w_k > 0.0:  # a leak that the fan ends is none of it
            w_k = inputs.stored * path.off_w_k
            network.paths[network.paths.index(path)] = path._replace(off_w_k=path.off_w_k - w_k)
            network.connect(path.one, UNSEEN, w_k)
            stored_w_k += w_k
    if stored_w_k > 0.0:
        network.add_node(UNSEEN, UNSEEN_TIMES * inputs.seen_s * stored_w_k)
    return network.system()
