"""A controller on the virtual rig: the whole daemon in lock-step with the board's process."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.controller import Controller
from edge.tick.reference import Reference
from training.lab import Lab

Floats = NDArray[np.float64]
ROOM_C = 22.0  # about the virtual board's; references are drawn for it


@dataclass(frozen=True, slots=True)
class Ticks:
    """Columns with a row per tick; what is driven holds from its row to the next.

    temp : measured, NaN where there is no good measurement [°C]; true : in the simulated box [°C]
    """

    temp: Floats
    true: Floats
    ambient: Floats
    reference: Floats
    duty: Floats
    fan: Floats
    decided: NDArray[np.bool_]  # by the controller itself, not by a fallback

    @property
    def error_k(self) -> Floats:
        """Measured air at the end of each step less the step's reference, [rows - 1]."""
        return self.temp[1:] - self.reference[:-1]

    def since(self, row: int) -> "Ticks":
        """Rows from `row` on."""
        return Ticks(*(getattr(self, name)[row:] for name in self.__slots__))


def without_forecasts(settings: Settings) -> Settings:
    """Return the loop without the bundle's models, which only watch: most of a tick's time is theirs."""
    return replace(
        settings,
        bundle=replace(settings.bundle, path=""),
        drift=replace(settings.drift, enabled=False),
    )


def run_on_rig(controller: Controller, reference: Reference, steps: int, seed: int) -> Ticks:
    """Run `controller` on a virtual board with `seed`, from a cold box on, for so many minutes."""
    settings = without_forecasts(config.default())
    settings = replace(settings, control=replace(settings.control, controller=controller.name))
    with Lab(
        settings, seed=seed, with_truth=True, reference=reference, more_controllers=(controller,)
    ) as lab:
        lab.run(ticks=steps + 1)
    columns = lab.columns()
    names = ("temp_air_c", "true_air_c", "temp_ambient_c", "reference_c", "heater_duty", "fan_on")
    decided = np.array(["instead_of" not in record.decision.why for record in lab.history])
    temp, true, ambient, wanted, duty, fan = (columns[name] for name in names)
    return Ticks(temp, true, ambient, wanted, duty, fan, decided)
