"""Boxes of the independent chamber, their runs, and values of the effects that a case declares as known.

`SETTINGS` says what each effect is there, and which values of the chamber say how much. Each of the chamber's
further effects, BYSTANDERS, acts in some boxes; what is known of these is calibrated as well as the twin's
equations can be, however badly that is. The fan does not stir the walls and the floor does not leak.
`imperfect_mixing` never acts: the chamber's fan blows through both zones in turn, the library's through one;
nor does the heater's thermostat, which nobody would calibrate a box with.

Runs have one reading a row and are driven without a board in between. A known value that the chamber has
under another name is read off. Walls, radiation and the element's lag are fitted by a calibration: the
chamber has no number for them in the twin's terms.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.case_files import run_of
from bench.hidden_effects.cases import STEP_S
from bench.hidden_effects.inputs import Floats
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import Effects

Settings = dict[str, float]  # "air.leak_flow_m3_s" or "effects.infiltration"
BASE: Settings = {
    "cover.inner_film_fan_w_m2_k": 0.0, "soil.floor_w_k": 0.0, "air.fan_mixing_flow_m3_s": 0.0,
    "heater.duty_window_s": 0.0, "heater.emissivity": 0.05, "led.light_share": 0.0, "led.power_w": 20.0,
    "heater.fan_convection_factor": 1.0, "room.diurnal_k": 0.3, "air.contact_capacity_factor": 3.0,
    "events.heat_noise_w": 0.0,
    "effects.ambient_diurnal": 1.0, "effects.ambient_wander": 1.0, "effects.power_run_variation": 1.0,
    "effects.power_wander": 1.0, "effects.heat_noise": 1.0, "effects.sensor_noise": 1.0,
    "effects.sensor_step": 1.0,
}  # fmt: skip
BYSTANDERS = (
    "natural_convection", "interior_longwave", "plant_mass", "condensation", "fan_motor_heat",
    "stack_ventilation",
)  # fmt: skip
BYSTANDER_ODDS = 0.12
QUIET: Settings = {
    "effects.power_run_variation": 0.0, "effects.power_wander": 0.0, "effects.sensor_noise": 0.0,
    "effects.sensor_step": 0.0,
}  # fmt: skip
# Sheets that let heat through, so that what happens at the outer one happens to the air.
THIN_WALLS: Settings = {"cover.inner_film_w_m2_k": 80.0, "cover.gap_w_m2_k": 150.0}
LEAD_ROWS = 40  # driven before the first row, where the box does not begin at rest
COLUMNS = ("temp_air_c", "temp_ambient_c", "light", "rel_humidity_pct")


class Setting(NamedTuple):
    """The setting that makes an effect as strong as a number says.

    value : that number's place, and `low`..`high` where it is searched for a size; `usual` where it is known
    form : what stands there is the strength ("same"), 1 minus it ("rest") or 1 over it ("inverse")
    others : switches and values that go with it
    """

    value: str
    low: float
    high: float
    usual: tuple[float, float]
    form: str = "same"
    others: tuple[tuple[str, float], ...] = ()
    signed: bool = False

    def at(self, strength: float, sign: float = 1.0) -> Settings:
        """All settings."""
        value = {"same": strength, "rest": 1.0 - strength, "inverse": 1.0 / strength}[self.form]
        return {self.value: sign * value if self.signed else value, **dict(self.others)}


def _on(name: str, *more: tuple[str, float]) -> tuple[tuple[str, float], ...]:
    return ((f"effects.{name}", 1.0), *more)


SETTINGS: Mapping[str, Setting] = {
    "wall_loss": Setting("cover.outer_film_w_m2_k", 0.02, 3.0, (5.0, 14.0), others=_on("wall_loss")),
    "infiltration": Setting("air.leak_flow_m3_s", 5e-5, 0.008, (0.0005, 0.002), others=_on("infiltration")),
    "wall_mass": Setting(
        "cover.heat_capacity_j_kg_k", 300.0, 40000.0, (2500.0, 8000.0), others=_on("wall_mass")
    ),
    "soil_mass": Setting("soil.capacity_j_k", 500.0, 80000.0, (5000.0, 25000.0), others=_on("soil_mass")),
    "extra_capacity": Setting(
        "air.contact_capacity_factor", 1.1, 15.0, (1.5, 6.0), others=_on("extra_capacity")
    ),
    "heater_lag": Setting("heater.capacity_j_k", 3.0, 300.0, (15.0, 80.0), others=_on("heater_lag")),
    "heater_deadtime": Setting("heater.deadtime_s", 5.0, 300.0, (20.0, 60.0), others=_on("heater_deadtime")),
    "heater_efficiency": Setting(
        "heater.efficiency", 0.005, 0.5, (0.03, 0.15), "rest", _on("heater_efficiency")
    ),
    "radiative_split": Setting(
        "effects.radiative_split", 0.02, 1.0, (0.3, 0.7), others=(("heater.emissivity", 0.92),)
    ),
    "heater_saturation": Setting(
        "heater.saturation_duty", 0.02, 0.8, (0.1, 0.3), "rest", _on("heater_saturation")
    ),
    "heater_sag": Setting("heater.sag", 0.005, 0.45, (0.05, 0.15), others=_on("heater_sag")),
    "longwave_radiation": Setting("effects.longwave_radiation", 0.01, 4.0, (0.5, 1.0)),
    "fan_effectiveness": Setting(
        "fan.effectiveness", 0.02, 0.9, (0.15, 0.4), "rest", _on("fan_effectiveness")
    ),
    "short_circuit": Setting("fan.short_circuit", 0.02, 0.9, (0.1, 0.3), others=_on("short_circuit")),
    "fan_deadtime": Setting("fan.deadtime_s", 3.0, 240.0, (10.0, 40.0), others=_on("fan_deadtime")),
    "fan_spinup": Setting("fan.spinup_s", 3.0, 240.0, (10.0, 40.0), others=_on("fan_spinup")),
    "sensor_lag": Setting("sensors.air_lag_s", 5.0, 900.0, (20.0, 90.0), others=_on("sensor_lag")),
    "sensor_bias": Setting(
        "sensors.air_bias_k", 0.05, 4.0, (0.2, 0.8), others=_on("sensor_bias"), signed=True
    ),
    "ambient_offset": Setting(
        "sensors.ambient_offset_k", 0.05, 5.0, (0.2, 0.8), others=_on("ambient_offset"), signed=True
    ),
    "constant_heat": Setting("events.constant_heat_w", 0.2, 40.0, (2.0, 8.0), others=_on("constant_heat")),
    "led_gain": Setting("led.power_w", 0.3, 80.0, (10.0, 25.0), others=_on("led_gain")),
    "evapotranspiration": Setting(
        "plant.transpiration_w_kpa", 0.3, 60.0, (2.0, 6.0), others=_on("evapotranspiration")
    ),
    "door_opening": Setting("events.door_w_k", 0.5, 300.0, (10.0, 30.0), others=_on("door_opening")),
    "ua_drift": Setting("cover.ua_drift_per_day", 0.001, 0.5, (0.01, 0.03), others=_on("ua_drift")),
}
OUTSIDE: Mapping[str, tuple[Setting, tuple[str, ...]]] = {
    "sun_window": (
        Setting("room.sun_w", 1.0, 150.0, (0, 0),
                others=_on("sun_window", ("room.sun_light", 0.0), ("room.sun_from_hour", 9.0),
                           ("room.sun_to_hour", 16.0))),
        ("time",),
    ),
    "room_draught": (
        Setting("cover.draught_share", 0.02, 2.0, (0, 0), others=_on("room_draught")),
        ("none",),
    ),
    "fan_clogging": (
        Setting("fan.clogging_per_day", 0.5, 40.0, (0, 0), others=_on("fan_clogging")),
        ("fan_on", "time"),
    ),
    "sensor_radiation": (
        Setting("sensors.radiation_k_w", 0.003, 0.3, (0, 0),
                others=_on("sensor_radiation", ("heater.emissivity", 0.92))),
        ("heater_duty",),
    ),
    "sensor_drift": (
        Setting("sensors.air_drift_k_day", 0.3, 60.0, (0, 0), others=_on("sensor_drift"), signed=True),
        ("time",),
    ),
    "heat_noise": (
        Setting("events.heat_noise_w", 2.0, 60.0, (0, 0), others=_on("heat_noise")),
        ("none",),
    ),
}  # fmt: skip


def chamber_of(settings: Mapping[str, float]) -> tuple[ChamberParameters, Effects]:
    """Return the chamber's parameters and switches; unset ones are off, or as in chamber.yaml."""
    parameters, _ = load()
    sections: dict[str, dict[str, float]] = {}
    for place, value in {**BASE, **settings}.items():
        section, _, key = place.partition(".")
        sections.setdefault(section, {})[key] = float(value)
    effects = Effects.none(**sections.pop("effects"))
    changed = {name: replace(getattr(parameters, name), **values) for name, values in sections.items()}
    return replace(parameters, **changed), effects


def draw_base(rng: Generator) -> Settings:
    """Films and contacts of a box, and what else acts in it."""
    also = {f"effects.{name}": 1.0 for name in BYSTANDERS if rng.random() < BYSTANDER_ODDS}
    return also | {
        "cover.inner_film_w_m2_k": rng.uniform(7.0, 14.0),
        "cover.outer_film_w_m2_k": rng.uniform(5.0, 14.0),
        "soil.air_w_k": rng.uniform(1.5, 4.0),
    }


def draw_known(rng: Generator, name: str) -> Settings:
    """Draw an effect of the size of known ones; walls with mass also let heat through."""
    own = SETTINGS[name]
    settings = own.at(rng.uniform(*own.usual), draw_sign(rng))
    return {**settings, "effects.wall_loss": 1.0} if name == "wall_mass" else settings


def draw_sign(rng: Generator) -> float:
    """Draw the sign of an effect with two signs."""
    return 1.0 if rng.random() < 0.5 else -1.0


@dataclass(frozen=True, slots=True)
class RunPlan:
    """A run before it is driven.

    duty, fan, light : [LEAD_ROWS + rows], those before the first row included
    day, hour : of the first row; room_c : mean temperature of the room that day
    seed : of the chamber's noise and weather
    """

    duty: Floats
    fan: Floats
    light: Floats
    day: float
    hour: float
    room_c: float
    seed: int

    def shorten(self, rows: int) -> "RunPlan":
        """Return the first rows of the plan, begun at rest."""
        cut = [column[: LEAD_ROWS + rows].copy() for column in (self.duty, self.fan, self.light)]
        for column in cut[:2]:
            column[:LEAD_ROWS] = 0.0
        return replace(self, duty=cut[0], fan=cut[1], light=cut[2])

    @property
    def first(self) -> int:
        """Row at which the chamber begins, at rest: LEAD_ROWS where nothing happens before."""
        before = self.duty[:LEAD_ROWS].any() or self.fan[:LEAD_ROWS].any()
        return 0 if before else LEAD_ROWS


@dataclass(frozen=True, slots=True)
class DrivenRun:
    """Columns of a run, one number a row.

    shown : what the sensors show; clean_c : the air's without noise and steps
    start : true temperatures at the first row
    """

    shown: Mapping[str, Floats]
    clean_c: Floats
    start: Mapping[str, float]


def drive(settings: Mapping[str, float], plan: RunPlan) -> DrivenRun:
    """Run the chamber through a plan."""
    begun_h = (plan.first - LEAD_ROWS) * STEP_S / 3600.0
    there = {
        "room.temp_c": plan.room_c,
        "room.start_hour": (plan.hour + begun_h) % 24.0,
        "room.start_day": plan.day + begun_h / 24.0,
    }
    parameters, effects = chamber_of({**settings, **there})
    chamber = Chamber(parameters, effects, plan.seed)
    bias_k = effects.sensor_bias * parameters.sensors.air_bias_k
    drift_k_s = effects.sensor_drift * parameters.sensors.air_drift_k_day / 86400.0
    shown: list[dict[str, float]] = []
    clean, start = [], {}
    for k in range(plan.first, len(plan.duty)):
        if k == LEAD_ROWS:
            start = {key: item for key, item in chamber.truth().items() if key.startswith("temp_")}
        if k >= LEAD_ROWS:
            shown.append(chamber.sense())
            clean.append(chamber.truth()["temp_sensor_c"] + bias_k + drift_k_s * chamber.time_s)
        chamber.step(STEP_S, plan.duty[k], bool(plan.fan[k]), plan.light[k], False)
    columns = {name: np.array([row[name] for row in shown]) for name in COLUMNS}
    return DrivenRun(columns, np.array(clean), start)


def quiet_c(settings: Mapping[str, float], plan: RunPlan) -> Floats:
    """Return the air sensor's readings without noise, steps and disturbances."""
    return drive({**settings, **QUIET}, plan).clean_c


def believed_c(settings: Mapping[str, float], plan: RunPlan) -> Floats:
    """Return the readings as predicted by someone who trusts the room's
    sensor: its offset has no effect on the air.
    """
    switch, offset_k = (
        settings.get(key, 0.0) for key in ("effects.ambient_offset", "sensors.ambient_offset_k")
    )
    return quiet_c(settings, replace(plan, room_c=plan.room_c + switch * offset_k))


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
