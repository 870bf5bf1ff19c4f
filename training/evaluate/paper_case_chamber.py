"""Truth of the simulated chamber from its own settings, to compare with the named effects.

Nothing that finds, fits or trains reads this.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from edge.core.predictor import Floats
from edge.twin.effects.library import USUAL_EFFECTS
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.profiles.record import RecordedRow, paths, read, record

DISTURBANCES = ("sensor_noise", "sensor_step", "ambient_diurnal", "ambient_wander", "power_run_variation",
                "power_wander")  # fmt: skip
QUIET = {"sensor_noise": 0.0, "sensor_step": 0.0}
PROFILE = 9  # a hot one of the training runs, on the board seed that it was recorded with
SIZES: Mapping[str, tuple[str, Callable[[ChamberParameters], float], str]] = {
    "infiltration": ("F_inf", lambda p: p.air.leak_flow_m3_s, "m³/s"),
    "wall_mass": (
        "C_w",
        lambda p: p.cover.areal_mass_kg_m2 * p.cover.heat_capacity_j_kg_k * p.box.cover_m2,
        "J/K",
    ),
    "soil_mass": ("C_s", lambda p: p.soil.capacity_j_k, "J/K"),
    "extra_capacity": ("kC", lambda p: p.air.contact_capacity_factor, ""),
    "heater_efficiency": ("eta", lambda p: p.heater.efficiency, ""),
    "fan_effectiveness": ("eps_f", lambda p: p.fan.effectiveness, ""),
    "fan_spinup": ("tau_f", lambda p: p.fan.spinup_s, "s"),
    "imperfect_mixing": ("F_mix", lambda p: p.air.mixing_flow_m3_s, "m³/s"),
    "sensor_lag": ("tau_s", lambda p: p.sensors.air_lag_s, "s"),
    # Of the errors of the two sensors a run shows the difference alone: that is what either has to come to.
    "sensor_bias": ("bias", lambda p: p.sensors.air_bias_k - p.sensors.ambient_offset_k, "K"),
    "ambient_offset": ("b_amb", lambda p: p.sensors.ambient_offset_k - p.sensors.air_bias_k, "K"),
    "ua_drift": ("ua_drift", lambda p: p.cover.ua_drift_per_day, "1/d"),
    "led_gain": ("P_led", lambda p: p.led.power_w, "W"),
}  # those that one of the chamber's values says; the others are many values or none


@dataclass(frozen=True, slots=True)
class Real:
    """An effect that acts in the chamber.

    parameter, value, unit : in the twin's terms; "", None, "" where none of the chamber's values says it
    shows_k : what the sensors' difference of air and room shows of it in a training run's profile, RMS [K]
    candidate : whether the diagnosis may name it
    """

    name: str
    parameter: str
    value: float | None
    unit: str
    shows_k: float
    candidate: bool


def real_effects(rows: Sequence[RecordedRow] | None = None) -> tuple[Real, ...]:
    """Return the effects that are switched on, the largest first. rows : instead of the profile's"""
    parameters, effects = load()
    applied = rows if rows is not None else read(paths()[PROFILE - 1])[1]
    quiet = replace(effects, **QUIET)
    whole = _readings(parameters, quiet, applied)
    found = []
    for field in fields(Effects):
        if getattr(effects, field.name) == 0.0 or field.name in DISTURBANCES:
            continue
        without = _readings(parameters, replace(quiet, **{field.name: 0.0}), applied)
        shows_k = float(np.sqrt(np.mean((whole - without) ** 2)))
        size = _size(field.name, parameters)
        found.append(Real(field.name, *size, shows_k, field.name in USUAL_EFFECTS))
    return tuple(sorted(found, key=lambda real: -real.shows_k))


def _size(name: str, parameters: ChamberParameters) -> tuple[str, float | None, str]:
    if name not in SIZES:
        return "", None, ""
    symbol, value, unit = SIZES[name]
    return symbol, value(parameters), unit


def _readings(parameters: ChamberParameters, effects: Effects, rows: Sequence[RecordedRow]) -> Floats:
    """Return the sensors' difference of air and room at each row [K]."""
    run = record(Chamber(parameters, effects, PROFILE), rows)
    return np.array([row["temp_air_c"] - row["temp_ambient_c"] for row in run])
