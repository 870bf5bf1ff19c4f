"""Actions of a policy: every level of the heater with the fan off, then all with the fan on."""

import numpy as np
from numpy.typing import NDArray

from edge.core.controller import ControlLimits
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS, levels_allowed

LEVELS = HEATER_LEVELS + 1  # off is one of them
ACTIONS = 2 * LEVELS


def command_of(action: int) -> Command:
    """Return the command of an action, 0 to ACTIONS - 1."""
    return Command(heater_duty=action % LEVELS / HEATER_LEVELS, fan_on=action >= LEVELS)


def duties_and_fans(actions: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the commands of many actions: duty 0..1 and fan 0 or 1."""
    return actions % LEVELS / HEATER_LEVELS, (actions >= LEVELS).astype(np.float64)


def action_of(command: Command) -> int:
    """Return the action nearest to a command."""
    return round(command.heater_duty * HEATER_LEVELS) + LEVELS * command.fan_on


def allowed_actions(limits: ControlLimits, last_sent: Command) -> NDArray[np.bool_]:
    """Which actions safety would let through as they are, [ACTIONS]: as of now, never none."""
    actions = np.arange(ACTIONS)
    free = actions % LEVELS <= levels_allowed(limits.heater_max_duty)
    if limits.fan_hold_steps > 0:
        free &= (actions >= LEVELS) == last_sent.fan_at_end
    return free
