"""Values of the effects that a case declares as known: read off the chamber, or fitted by a calibration.

A value that the chamber has under another name is that value. Walls, radiation and the element's lag are
fitted: the chamber has no number for them in the twin's terms.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.hidden_effects.chamber_box import BASE, QUIET, Settings
from bench.hidden_effects.chamber_runs import LEAD_ROWS, RunPlan, drive
from bench.hidden_effects.draw_readings import run_of
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

DIRECT: Mapping[str, Mapping[str, str]] = {
    "infiltration": {"F_inf": "air.leak_flow_m3_s"},
    "soil_mass": {"C_s": "soil.capacity_j_k", "G_s": "soil.air_w_k"},
    "extra_capacity": {"kC": "air.contact_capacity_factor"},
    "heater_deadtime": {"d_h": "heater.deadtime_s"},
    "heater_efficiency": {"eta": "heater.efficiency"},
    "heater_saturation": {"u_sat": "heater.saturation_duty"},
    "heater_sag": {"sag": "heater.sag"},
    "fan_effectiveness": {"eps_f": "fan.effectiveness"},
    "short_circuit": {"s_sc": "fan.short_circuit"},
    "fan_deadtime": {"d_f": "fan.deadtime_s"},
    "fan_spinup": {"tau_f": "fan.spinup_s"},
    "sensor_lag": {"tau_s": "sensors.air_lag_s"},
    "sensor_bias": {"bias": "sensors.air_bias_k"},
    "ambient_offset": {"b_amb": "sensors.ambient_offset_k"},
    "constant_heat": {"P0": "events.constant_heat_w"},
    "led_gain": {"P_led": "led.power_w"},
    "door_opening": {"G_door": "events.door_w_k"},
}


class ChamberCalibration(NamedTuple):
    """Parameters by effect, and the error of free runs with them [K]."""

    effects: dict[str, dict[str, float]]
    rmse_k: float


def read_off(names: Sequence[str], settings: Settings) -> dict[str, dict[str, float]]:
    """Return the true parameters in the library's terms, of the effects that have them."""
    found = {**BASE, **settings}
    return {
        name: {key: float(found[place]) for key, place in DIRECT[name].items()}
        for name in names
        if name in DIRECT
    }


def calibrate(names: Sequence[str], settings: Settings, plans: Sequence[RunPlan]) -> ChamberCalibration:
    """All parameters of these effects, from quiet runs of a chamber that has them and no other."""
    direct = read_off(names, settings)
    if set(names) <= set(direct):
        return ChamberCalibration(direct, 0.0)
    file = TwinFile(
        effects={
            name: {
                item.name: Value(direct[name][item.name]) if name in direct else Value(item.start, fit=True)
                for item in EFFECTS[name].parameters
            }
            for name in names
        },
        sensor={"quantisation_k": None, "noise_sd_k": 0.02},
    )
    runs = []
    for plan in plans:
        shown = drive({**settings, **QUIET}, plan).shown
        commands = {"heater_duty": plan.duty[LEAD_ROWS:], "fan_on": plan.fan[LEAD_ROWS:]}
        runs.append(run_of({**shown, **commands}, "train", plan.day, plan.hour))
    fit = fit_twin(file, runs)
    effects = {name: {key: item.value for key, item in own.items()} for name, own in fit.file.effects.items()}
    return ChamberCalibration(effects, fit.rmse_k)
