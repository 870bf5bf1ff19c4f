"""Terms of the residual heat that the peers regress on, and what each is called.

A peer regresses what the declared twin misses over one step on terms made of the measured columns, and calls
each chosen term by the effect that it would be. The twin is taken at the values that its file gives; a peer
refits nothing of it.

What no such regression can name, whatever is chosen: an effect whose signature is that of another effect's
term (`short_circuit` is `fan_effectiveness`, `radiative_split` is `heater_efficiency`, `sensor_bias` is
`ambient_offset`, `heater_deadtime` is `heater_lag`, `fan_deadtime` is `fan_spinup`), what happens between two
samples (`imperfect_mixing`, `sensor_lag`), what happens at times that no column tells (`door_opening`), and
anything outside the library: a peer never says `unknown`. It gives no alternatives. Hidden bodies
(`soil_mass`, `wall_mass`) are guessed from the air's mean of the last hour, and what is not linear in its
parameter is named without one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.twin.model import BoxTwin

Floats = NDArray[np.float64]
_BENDS_ABOVE = 0.6  # duty


@dataclass(frozen=True, slots=True)
class TermColumns:
    """Columns at one row or at many; slow_c : the air's mean of the last hour; *_before : a row earlier."""

    temp: Floats
    temp_before: Floats
    slow_c: Floats
    ambient: Floats
    duty: Floats
    duty_before: Floats
    fan: Floats
    fan_before: Floats
    light: Floats
    deficit_kpa: Floats
    day: Floats

    @property
    def excess(self) -> Floats:
        return self.temp - self.ambient


@dataclass(frozen=True, slots=True)
class TermParameter:
    """A parameter's value from the term's coefficient `of`, in proportion but for a constant."""

    name: str
    unit: str
    of: Callable[[float, BoxTwin], float]


@dataclass(frozen=True, slots=True)
class PeerTerm:
    """heat : the term [unit]; its coefficient [W per unit] tells the effect's parameter, if there is one."""

    effect: str
    heat: Callable[[TermColumns], Floats]
    parameter: TermParameter | None = None


def _exhaust_w_k(twin: BoxTwin) -> float:
    return twin.geometry.volumetric_heat_j_m3_k * twin.geometry.fan_max_m3_s


TERMS: tuple[PeerTerm, ...] = (
    PeerTerm("wall_loss", lambda r: r.excess, TermParameter("UA", "W/K", lambda c, t: -c)),
    PeerTerm("infiltration", lambda r: (1.0 - r.fan) * r.excess,
         TermParameter("F_inf", "m³/s", lambda c, t: -c / t.geometry.volumetric_heat_j_m3_k)),
    PeerTerm("fan_effectiveness", lambda r: r.fan * r.excess,
         TermParameter("eps_f", "", lambda c, t: 1.0 - c / _exhaust_w_k(t))),
    PeerTerm("longwave_radiation", lambda r: r.excess**2),
    PeerTerm("heater_efficiency", lambda r: r.duty,
         TermParameter("eta", "", lambda c, t: 1.0 + c / t.geometry.heater_max_w)),
    PeerTerm("heater_sag", lambda r: r.duty**2,
         TermParameter("sag", "", lambda c, t: -c / t.geometry.heater_max_w)),
    PeerTerm("heater_saturation", lambda r: np.maximum(r.duty - _BENDS_ABOVE, 0.0)),
    PeerTerm("heater_lag", lambda r: r.duty - r.duty_before),
    PeerTerm("fan_spinup", lambda r: (r.fan - r.fan_before) * r.excess),
    PeerTerm("extra_capacity", lambda r: r.temp - r.temp_before),
    PeerTerm("soil_mass", lambda r: r.temp - r.slow_c),
    PeerTerm("wall_mass", lambda r: r.slow_c - r.ambient),
    PeerTerm("constant_heat", lambda r: np.ones_like(r.temp), TermParameter("P0", "W", lambda c, t: c)),
    PeerTerm("ambient_offset", lambda r: r.fan),
    PeerTerm("led_gain", lambda r: r.light, TermParameter("P_led", "W", lambda c, t: c)),
    PeerTerm("evapotranspiration", lambda r: (0.4 + 0.6 * r.light) * r.deficit_kpa,
         TermParameter("k_e", "W/kPa", lambda c, t: -c)),
    PeerTerm("ua_drift", lambda r: r.day * r.excess),
)  # fmt: skip
