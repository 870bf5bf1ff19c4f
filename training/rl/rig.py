"""A controller on the virtual rig: the whole daemon in lock-step with the board's process."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.app.daemon import Daemon
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.controller import Controller
from edge.core.messages import ReadingQuality, TickRecord
from edge.tick.reference import Reference

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
    """The same loop without the bundle's models, which only watch: most of a tick's time is theirs."""
    return replace(
        settings,
        bundle=replace(settings.bundle, path=""),
        drift=replace(settings.drift, enabled=False),
    )


def run_on_rig(controller: Controller, reference: Reference, steps: int, seed: int) -> Ticks:
    """`controller` on a virtual board with `seed`, from a cold box on, for so many minutes."""
    rows: list[tuple[float, ...]] = []
    with tempfile.TemporaryDirectory(prefix="rl-rig-") as temporary:
        folder = Path(temporary)
        settings = without_forecasts(settings_in(folder, config.default()))
        settings = replace(settings, control=replace(settings.control, controller=controller.name))
        with virtual_rig(folder, seed) as rig:
            clock = SimClock(rig.control)

            def after_tick(record: TickRecord) -> None:
                rows.append(_row(record, clock.truth()["chamber"]["temp_air_c"]))
                if len(rows) > steps:
                    daemon.stop()

            try:
                with Daemon(settings, clock, after_tick, reference, more_controllers=(controller,)) as daemon:
                    daemon.run()
            finally:
                clock.close()
    *columns, decided = (np.array(column) for column in zip(*rows, strict=True))
    return Ticks(*columns, decided.astype(bool))


def _row(record: TickRecord, true_c: float) -> tuple[float, ...]:
    air, echo = record.readings["temp_air"], record.echo
    return (
        air.value if air.quality is ReadingQuality.GOOD and air.value is not None else np.nan,
        true_c,
        record.estimate.temp_ambient,
        record.reference_c,
        echo.heater_duty if echo is not None else 0.0,
        float(echo.fan_on) if echo is not None else 0.0,
        float("instead_of" not in record.decision.why),
    )
