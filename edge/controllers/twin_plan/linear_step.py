"""One step of a twin as matrices, one set for each way the fan can go on.

Late commands and a fan that spins up make a step depend on the command before it; so the fan's state before
and the duty before are inputs too. A fan that is on for a share of the step is on at its beginning. Exact for
a twin whose heat is linear in its temperatures; else it is the tangent at the state given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import NDArray

from edge.core.names import HEATER_LEVELS
from edge.twin.model import BoxTwin
from edge.twin.network import AIR
from edge.twin.rollout import Commands, fan_in_parts
from edge.twin.signals import Conditions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
WHOLE_STEPS = (0.0, 1.0)  # the fan is off, or on for all of a step
PARTS_MAX = 600  # of a step
LOOKS = 4  # times at which a step with parts is judged, its end with them


@dataclass(frozen=True, slots=True, eq=False)
class LinearStep:
    """x+ = matrix x + constant + room T_amb + now s + late s_before + heat d, for each of M modes.

    A mode is the fan's state before (off, on) and, of each, what it does in the step: one of `fans`.
    matrix : [M, n, n]; the others [M, n]
    room : by 1 K of the room; heat : by heat into the air that alone would warm it by 1 K in the step
    now, late : by the share of the heater's power that the duty of this step, and of the one before, asks for
    share : of each heater level, [21]
    fans : shares of a step for which the fan can be on, rising from 0 to 1, [M / 2]
    within : what the sensor shows at P times within the step, [M, P, n + 5], by state, constant, room, now,
        late and heat as above; P is 0 where the fan is off or on for all of a step
    air, shown : which state is the air's temperature, and which the sensor shows
    """

    matrix: Floats
    constant: Floats
    room: Floats
    now: Floats
    late: Floats
    heat: Floats
    share: Floats
    fans: Floats
    within: Floats
    air: int
    shown: int = 0

    def mode(self, fan_before: Ints, fan: Ints) -> Ints:
        """Return places among the modes. fan_before : 0 off, 1 on; fan : places in `fans`"""
        return len(self.fans) * fan_before + fan

    def place_of(self, fan: float) -> int:
        """Return the place in `fans` of the share nearest to this one."""
        return int(np.argmin(np.abs(self.fans - fan)))

    def share_of(self, duty: float) -> float:
        """Share of the heater's power at a duty, between two levels too."""
        return float(np.interp(duty, np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS, self.share))


def linear_step(
    twin: BoxTwin,
    state: Floats,
    ambient: float,
    conditions: Conditions,
    fans: Sequence[float] = WHOLE_STEPS,
) -> LinearStep:
    """Linearise the step of `twin` at a state [n], with columns of one row each as they are now.

    fans : as `LinearStep.fans`
    Errors : DataError naming a column that is missing
    """
    # By unit differences of one batch of steps: exact for linear effects, late and slow ones too.
    size, parts = len(state), _parts(fans)
    rows = size + 5  # as it is, each state, room, duty now, duty before, heat: one more each
    modes = [(before, fan) for before in WHOLE_STEPS for fan in fans]
    states = np.tile(state, (len(modes) * rows, 1))
    room, source, duty, before = (np.zeros(len(states)) for _ in range(4))
    fan_before, fan = np.repeat(np.array(modes), rows, axis=0).T
    for first in range(0, len(states), rows):
        states[first + 1 + np.arange(size), np.arange(size)] += 1.0
        room[first + size + 1] = duty[first + size + 2] = before[first + size + 3] = 1.0
        source[first + size + 4] = 1.0 / twin.step_s
    part_s = twin.step_s / parts
    begins_s = np.linspace(0.0, twin.step_s, parts, endpoint=False, dtype=np.float64)
    march = twin.march(
        Commands(_in_parts(duty, parts), fan_in_parts(fan[:, None], begins_s, part_s, twin.step_s)),
        _in_parts(ambient + room, parts),
        _in_parts(source, parts),
        conditions,
        Commands(_in_parts(before, parts), _in_parts(fan_before, parts)),
        part_s,
    )
    marks, seen = look_marks(parts), []
    for part in range(parts):
        states = march.step(part, states)
        if part + 1 in marks:
            seen.append(states[:, 0])
    after = states.reshape(len(modes), rows, size)
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
        fans=np.array(fans),
        within=_within(np.array(seen).reshape(len(marks), len(modes), rows), state, ambient, full),
        air=twin.states.index(AIR),
    )


def look_marks(parts: int) -> tuple[int, ...]:
    """Return after how many parts of a step its course is looked at before its end: never in one part."""
    return tuple(sorted({round(parts * look / LOOKS) for look in range(1, LOOKS)} - {0, parts}))


def _within(seen: Floats, state: Floats, ambient: float, full: float) -> Floats:
    """seen : [P, M, rows], as it is and by unit differences. Returns : [M, P, n + 5], see `LinearStep`"""
    size = len(state)
    by_one = np.moveaxis(seen[:, :, 1:] - seen[:, :, :1], 0, 1)
    room, now, late, heat = (by_one[..., size + k] for k in range(4))
    constant = seen[:, :, 0].T - by_one[..., :size] @ state - room * ambient
    columns = [constant, room, now / full, late / full, heat]
    return np.concatenate([by_one[..., :size], np.stack(columns, axis=-1)], axis=-1)


def _parts(fans: Sequence[float]) -> int:
    """Return the least number of equal parts of a step of which each share takes whole ones."""
    return lcm(*(Fraction(fan).limit_denominator(PARTS_MAX).denominator for fan in fans))


def _in_parts(values: Floats, parts: int) -> Floats:
    """[B] as [B, parts]."""
    return np.repeat(values[:, None], parts, axis=1)
