"""The one seam of every controller: `decide(context) -> Decision`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.messages import Command, Decision, Estimate
from edge.core.names import HEATER_MAX_W

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class ControlLimits:
    """The limits of the safety supervisor now; a controller plans inside them."""

    heater_max_duty: float = 1.0
    fan_hold_steps: int = 0  # steps for which the relay must keep its present state (minimum on/off time)
    fan_min_on_steps: int = 1  # a switch on lasts at least this long [steps]
    fan_min_off_steps: int = 1
    temp_air_max_c: float = 60.0
    fan_part_s: float = 5.0  # shortest part of a step for which the fan may be on [s]
    fan_starts: int = 30  # so often the relay may still be closed within the hour
    heater_w: float = HEATER_MAX_W  # of this box, at full duty
    fan_role: str = "exhaust"  # of this box, or stirring, or none
    proof_in_steps: int | None = None  # until heat and fan are held back for the relay's proof; None: unseen


@dataclass(frozen=True, slots=True)
class Penalty:
    """The costs of actuator use that an operator requested; None: those of the controller's name."""

    heater: float | None = None
    fan: float | None = None


@dataclass(frozen=True, slots=True)
class Context:
    """All that a controller may know at a tick.

    history : columns of equal length n (at most 120), one row per past tick, oldest first; the last row is
        now. `temp_air` [°C] holds estimates and has no NaN; `temp_air_measured` may; `temp_ambient` [°C];
        `heater_duty`, `fan_on` as sent, NaN in the last row (not decided yet); `utc` [s]; other signals of
        `edge.core.names` where the board has them.
    reference : target for the air temperature after each of the next steps, shape [K], K >= any horizon [°C];
        what a controller may use of it is its preview's to say: see `goal_ahead`.
    """

    now_s: float
    utc: float
    step_s: float
    history: Columns
    estimate: Estimate
    reference: Floats
    last_sent: Command
    limits: ControlLimits
    penalty: Penalty = field(default_factory=Penalty)


def goal_ahead(context: Context, steps: int, preview: bool) -> Floats:
    """Return the reference [steps] that a controller plans for [°C].

    preview : the coming reference; False holds the present one, which is all that the paper's MPC knows
    Raises : DataError where less of the coming reference is known
    """
    if not preview:
        return np.full(steps, context.reference[0])
    if len(context.reference) < steps:
        raise DataError(f"reference: {len(context.reference)} steps, horizon and tail have {steps}")
    return context.reference[:steps]


class Controller(Protocol):
    """Pure in its decisions: the same context gives the same decision."""

    @property
    def name(self) -> str:
        """Public name, e.g. `MPC-P`."""
        ...

    def decide(self, context: Context) -> Decision:
        """Choose the command for the step that begins now."""
        ...

    def reset(self) -> None:
        """Forget warm starts and integrals: called when the controller is switched in."""
        ...
