"""The inputs on their way into the balance: what a command becomes, and heat that comes from elsewhere."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError

Floats = NDArray[np.float64]
Conditions = Mapping[str, Floats]  # columns beside the room: light, rel_humidity, utc, door_open


class HeatConditions(NamedTuple):
    """Conditions that heat can depend on, arrays of one shape. Temperatures
    are the true ones, not the readings.
    """

    temp: Floats  # air [°C]
    ambient: Floats  # room [°C]
    column: (
        Conditions  # and fan_on, for heat that does not depend on the temperature, heater_duty for what does
    )


HeatNow = Callable[[HeatConditions], Floats]


class Heat(NamedTuple):
    """Heat into the air."""

    watts: HeatNow
    by_temp: bool  # whether it depends on the air's temperature


@dataclass(slots=True)
class Signals:
    """Changes of the inputs before they act; the defaults are none.

    The twin's temperatures are those that the sensor shows, so a bias of the sensor moves the room instead.
    """

    duty_limit: float = np.inf
    duty_sag: float = 0.0
    heater_dead_s: float = 0.0
    fan_dead_s: float = 0.0
    fan_lag_s: float = 0.0
    ambient_error_k: float = 0.0  # measured minus true
    sensor_bias_k: float = 0.0  # shown minus true
    heats: list[Heat] = field(default_factory=list)
    door: bool = False
    ageing_per_day: float = 0.0  # of the walls' conductance

    @property
    def plain(self) -> bool:
        """True if the inputs enter the balance unchanged."""
        return self == Signals()

    @property
    def steady(self) -> bool:
        """True if one matrix per fan speed makes a step."""
        times = self.heater_dead_s + self.fan_dead_s + self.fan_lag_s
        return times == 0.0 and not self.bends and not self.door and self.ageing_per_day == 0.0

    @property
    def bends(self) -> bool:
        """True if heat depends on the air temperature other than in proportion."""
        return any(heat.by_temp for heat in self.heats)

    def duty(self, commanded: Floats) -> Floats:
        """Share of the heater's power, of the shape given."""
        limited = np.minimum(commanded, self.duty_limit)
        return limited * (1.0 - self.duty_sag * limited)

    def days(self, since_first: Floats) -> Floats:
        """Days that count: walls age until nothing is left of their conductance, and no further."""
        return np.maximum(self.ageing_per_day * since_first, -1.0) / self.ageing_per_day

    def room(self, measured: Floats) -> Floats:
        """Return the ambient as the air's sensor would show it [°C]."""
        return measured + (self.sensor_bias_k - self.ambient_error_k)

    def heat_w(
        self, shown: Floats, measured_room: Floats, columns: Conditions, by_temp: bool
    ) -> Floats | float:
        """Heat into the air [W]; of the heats that depend on its temperature, or of those that do not."""
        now = HeatConditions(shown - self.sensor_bias_k, measured_room - self.ambient_error_k, columns)
        return sum((heat.watts(now) for heat in self.heats if heat.by_temp is by_temp), start=0.0)


def columns_of(needs: Mapping[str, str], given: Conditions | None) -> Conditions:
    """Return the needed columns. needs : by column, the effect that needs it.
    Errors: DataError naming the missing column
    """
    columns = given or {}
    for name, effect in needs.items():
        if name not in columns:
            raise DataError(f"{name}: missing, the twin's {effect} needs this column")
    optional = {"door_open"} & set(columns)  # a door is closed unless it is known to be open
    return {name: np.asarray(columns[name], dtype=np.float64) for name in (*needs, *optional)}
