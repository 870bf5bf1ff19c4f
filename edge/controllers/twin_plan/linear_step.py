"""One step of a twin as matrices, one set for each way the fan can go on.

Late commands and a fan that spins up make a step depend on the command before it; so the fan's state before
and the duty before are inputs too. Exact for a twin whose heat is linear in its temperatures; else it is the
tangent at the state given.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.names import HEATER_LEVELS
from edge.twin.model import BoxTwin
from edge.twin.network import AIR
from edge.twin.rollout import Commands
from edge.twin.signals import Conditions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
MODES = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))  # fan before, fan now


@dataclass(frozen=True, slots=True, eq=False)
class LinearStep:
    """x+ = matrix x + constant + room T_amb + now s + late s_before + heat d, for each of `MODES`.

    matrix : [4, n, n]; the others [4, n]
    room : by 1 K of the room; heat : by heat into the air that alone would warm it by 1 K in the step
    now, late : by the share of the heater's power that the duty of this step, and of the one before, asks for
    share : of each heater level, [21]
    air, shown : which state is the air's temperature, and which the sensor shows
    """

    matrix: Floats
    constant: Floats
    room: Floats
    now: Floats
    late: Floats
    heat: Floats
    share: Floats
    air: int
    shown: int = 0

    def mode(self, fan_before: Ints, fan: Ints) -> Ints:
        """Places in `MODES`."""
        return 2 * fan_before + fan

    def share_of(self, duty: float) -> float:
        """Share of the heater's power at a duty, between two levels too."""
        return float(np.interp(duty, np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS, self.share))


def linear_step(twin: BoxTwin, state: Floats, ambient: float, conditions: Conditions) -> LinearStep:
    """Linearise the step of `twin` at a state [n], with columns of one row each as they are now.

    Errors : DataError naming a column that is missing
    """
    # By unit differences of one batch of steps: exact for linear effects, late and slow ones too.
    size = len(state)
    rows = size + 5  # as it is, each state, room, duty now, duty before, heat: one more each
    states = np.tile(state, (len(MODES) * rows, 1))
    room, source, duty, before = (np.zeros(len(states)) for _ in range(4))
    fan = np.repeat(np.array(MODES), rows, axis=0)
    for first in range(0, len(states), rows):
        states[first + 1 + np.arange(size), np.arange(size)] += 1.0
        room[first + size + 1] = duty[first + size + 2] = before[first + size + 3] = 1.0
        source[first + size + 4] = 1.0 / twin.step_s
    march = twin.march(
        Commands(duty[:, None], fan[:, 1:]),
        (ambient + room)[:, None],
        source[:, None],
        conditions,
        Commands(before[:, None], fan[:, :1]),
    )
    after = march.step(0, states).reshape(len(MODES), rows, size)
    by_one = after[:, 1:] - after[:, :1]
    matrix = np.swapaxes(by_one[:, :size], 1, 2)
    share = np.asarray(twin.signals.duty(np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS), dtype=np.float64)
    full = share[-1] or 1.0
    return LinearStep(
        matrix=matrix,
        constant=after[:, 0] - matrix @ state - by_one[:, size] * ambient,
        room=by_one[:, size],
        now=by_one[:, size + 1] / full,
        late=by_one[:, size + 2] / full,
        heat=by_one[:, size + 3],
        share=share,
        air=twin.states.index(AIR),
    )
