"""Bounds that a box keeps: what thermal supervision and the energy caps know of it.

The defaults are those of the paper's box. Another box has its own, with margins, from its twin file.
"""

from dataclasses import dataclass, replace

from edge.core.names import HEATER_MAX_W


@dataclass(frozen=True, slots=True)
class BoxBounds:
    """Least and most of what a box can be.

    heater_w : rated, 0 where unknown; power : what the element takes [W]; element_lag_s : slowest, on and off
    capacity_max : all that is warmed [J/K]; capacity_min : what takes part within minutes
    loss, fan : conductance to the room through the walls, and by the fan [W/K]
    fan_weak_w_k : a fan is called blocked only below this
    other_heat_w : sun through a window, a pump, a wall that is still warm: heat that is nobody's fault;
        other_heat_long_w : the same over an hour, in which the walls' part averages out
    other_heat_k : what it makes at most with the fan on
    air_rate_max_k_s : its air warms or cools no faster [K/s]
    """

    heater_w: float = HEATER_MAX_W
    power_min_w: float = 75.0  # 10 % low mains is 19 % less heat, and some is lost in the supply
    power_max_w: float = 110.0
    element_lag_s: float = 300.0  # slowest ceramic emitter
    capacity_max_j_k: float = 10000.0  # air, cover, pot of wet soil: 0.2 + 3 + 4.2 kJ/K, and a third more
    capacity_min_j_k: float = 3000.0  # air, inner sheet, part of the rest
    loss_max_w_k: float = 10.0  # 1.7 m² of twin-wall sheet at 3.3 W/m²K, and leaks
    loss_min_w_k: float = 4.0
    fan_min_w_k: float = 11.0  # half of the rated 68 m³/h; 1207 J/m³K
    fan_weak_w_k: float = 8.0  # a third of its rated flow
    other_heat_w: float = 50.0
    other_heat_long_w: float = 30.0
    other_heat_k: float = 4.0
    air_rate_max_k_s: float = 0.1
    fan_cools: bool = True  # False for one that only stirs, and without a fan
    fan_role: str = "exhaust"  # of the twin file

    @property
    def is_known(self) -> bool:
        """False for a box of which heater and fan alone are known."""
        return self.capacity_max_j_k < NO_BOUND


UNKNOWN_RATE_K_S = 2.0  # 20 K at once, behind a sensor of 10 s
NO_BOUND = 1e9  # finite, so that its product with nothing is nothing
PAPER_BOX = BoxBounds()


def paper_box(heater_w: float) -> BoxBounds:
    """Return the bounds of the paper's box with a heater of this power, 0 where no one has named one."""
    times = heater_w / HEATER_MAX_W
    return replace(
        PAPER_BOX,
        heater_w=heater_w,
        power_min_w=times * PAPER_BOX.power_min_w,
        power_max_w=times * PAPER_BOX.power_max_w,
        air_rate_max_k_s=max(times, 1.0) * PAPER_BOX.air_rate_max_k_s,
    )


def unknown_box(heater_w: float, fan_role: str) -> BoxBounds:
    """Return the bounds of a box of which heater and fan alone are known: no question has an answer."""
    return BoxBounds(
        heater_w=heater_w,
        power_max_w=1.1 * heater_w,
        power_min_w=0.75 * heater_w,
        capacity_max_j_k=NO_BOUND,
        capacity_min_j_k=0.0,
        loss_max_w_k=NO_BOUND,
        loss_min_w_k=0.0,
        fan_min_w_k=0.0,
        fan_cools=False,
        fan_role=fan_role,
        other_heat_w=NO_BOUND,
        other_heat_long_w=NO_BOUND,
        air_rate_max_k_s=UNKNOWN_RATE_K_S,
    )
