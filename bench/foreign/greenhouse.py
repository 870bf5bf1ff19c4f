"""The user's own greenhouse: cases of the virtual board's chamber, with an effect that the twin lacks.

The chamber has many nodes where the twin has few; some of what it has besides acts in some cases. Runs are
driven without a board in between. `imperfect_mixing` is never hidden: the chamber's fan blows through both
zones in turn, the library's through one; nor is an effect that a fitted loss, capacity and fan take up.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from bench.foreign.box import DRIVES, Control, Floats, draw_control, spells
from bench.foreign.cases import ForeignCase, Recording, log_files
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import Effects

Settings = Mapping[str, float]  # "air.leak_flow_m3_s" or "effects.infiltration"
HIDDEN, NULL = KINDS = ("greenhouse", "greenhouse_null")
STEP_S = 60.0
TAU_S, RISE_K = 600.0, 18.0  # by which the owner's control is drawn
SIZE_K = (0.4, 3.0)  # that a run is off without the effect, root mean square
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
SHOWN = ("temp_air_c", "temp_ambient_c", "light", "rel_humidity_pct")


class Setting(NamedTuple):
    """How strong an effect is.

    place : of the chamber's value that says so, drawn from `low`..`high`
    parameter : the library's, where it means the same; also : what goes with the effect
    """

    place: str
    low: float
    high: float
    parameter: str = ""
    also: tuple[tuple[str, float], ...] = ()


SETTINGS: Mapping[str, Setting] = {
    "heater_lag": Setting("heater.capacity_j_k", 20.0, 250.0),
    "soil_mass": Setting("soil.capacity_j_k", 3000.0, 40000.0, "C_s"),
    "sensor_lag": Setting("sensors.air_lag_s", 60.0, 700.0, "tau_s"),
    "wall_mass": Setting("cover.heat_capacity_j_kg_k", 2000.0, 20000.0),
    "heater_deadtime": Setting("heater.deadtime_s", 60.0, 300.0, "d_h"),
    "heater_saturation": Setting("heater.saturation_duty", 0.3, 0.85, "u_sat"),
    "constant_heat": Setting("events.constant_heat_w", 3.0, 25.0, "P0"),
    "heater_sag": Setting("heater.sag", 0.1, 0.45, "sag"),
    "fan_effectiveness": Setting("fan.effectiveness", 0.2, 0.8, "eps_f"),
    "infiltration": Setting("air.leak_flow_m3_s", 0.0003, 0.005, "F_inf"),
    "short_circuit": Setting("fan.short_circuit", 0.2, 0.8, "s_sc"),
    "fan_deadtime": Setting("fan.deadtime_s", 60.0, 240.0, "d_f"),
    "fan_spinup": Setting("fan.spinup_s", 60.0, 240.0, "tau_f"),
    "radiative_split": Setting("effects.radiative_split", 0.3, 1.0, also=(("heater.emissivity", 0.92),)),
    "led_gain": Setting("led.power_w", 5.0, 40.0, "P_led"),
    "evapotranspiration": Setting("plant.transpiration_w_kpa", 3.0, 40.0),
}
OF_FAN = ("fan_effectiveness", "infiltration", "short_circuit")  # a fitted fan would take them up
OF_LAMP = ("led_gain", "evapotranspiration")  # not identifiable without its column
OF_POWER = ("heater_saturation", "heater_sag")  # several levels of the heater tell them


@dataclass(frozen=True, slots=True)
class ChamberDay:
    """hour : of the first row; room_c : mean that day; light : by row; seed : of noise and weather"""

    hour: float
    room_c: float
    light: Floats
    seed: int


def drive(settings: Settings, day: ChamberDay, control: Control) -> dict[str, Floats]:
    """Return a run's columns, from rest; `clean_c`: what the sensor would show without noise and steps."""
    there = {"room.temp_c": day.room_c, "room.start_hour": day.hour, "room.start_day": 0.0}
    chamber = Chamber(*_chamber_of({**settings, **there}), day.seed)
    rows = []
    for k, light in enumerate(day.light):
        seen = chamber.sense()
        clean_c = chamber.truth()["temp_sensor_c"]
        duty, fan = control(k, seen["temp_air_c"])
        shown = {name: seen[name] for name in SHOWN}
        rows.append({**shown, "clean_c": clean_c, "heater_duty": duty, "fan_on": fan})
        chamber.step(STEP_S, duty, bool(fan), light, False)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _chamber_of(settings: Settings) -> tuple[ChamberParameters, Effects]:
    """Return the chamber's parameters and switches; unset ones are off, or as in chamber.yaml."""
    parameters, _ = load()
    sections: dict[str, dict[str, float]] = {}
    for place, value in {**BASE, **settings}.items():
        section, _, key = place.partition(".")
        sections.setdefault(section, {})[key] = float(value)
    effects = Effects.none(**sections.pop("effects"))
    changed = {name: replace(getattr(parameters, name), **values) for name, values in sections.items()}
    return replace(parameters, **changed), effects


def attempt(rng: Generator, kind: str, number: int) -> ForeignCase | None:
    """Draw a case; None where what is hidden shows too little or too much. Effects take turns."""
    name = list(SETTINGS)[number % len(SETTINGS)] if kind == HIDDEN else ""
    known = _draw_known(rng)
    hidden = _draw_hidden(rng, name)
    rows, runs = int(rng.integers(150, 211)), int(rng.integers(2, 5))
    control_kind = str(rng.choice(("steps", "climb") if name in OF_POWER else DRIVES))
    usual_c, lit = rng.uniform(19.0, 23.0), name in OF_LAMP or rng.random() < 0.5
    recordings, size_k = [], 0.0
    for _ in range(runs):
        day = _draw_day(rng, rows, usual_c)
        control = draw_control(rng, control_kind, rows, STEP_S, TAU_S, RISE_K, day.room_c, True)
        run = drive({**known, **hidden}, day, control)
        more = {column: run[column] for column in ("light", "rel_humidity_pct")} if lit else {}
        recordings.append(
            Recording(run["temp_ambient_c"], run["clean_c"], run["heater_duty"], run["fan_on"], more)
        )
    if name:
        size_k = _size_k(known, day, run)
        if not SIZE_K[0] <= size_k <= SIZE_K[1]:
            return None
    noise_k, step_k = float(rng.uniform(0.05, 0.1)), 0.1
    truth: dict[str, Any] = {
        "hidden": {name: _values(name, hidden)} if name else {}, "outside": "", "depends_on": [],
        "shown_k": {name: round(size_k, 4)} if name else {},
        "known": {"kC": known["air.contact_capacity_factor"]},
        "noise_k": noise_k, "step_k": step_k, "control": control_kind, "settings": {**known, **hidden},
    }  # fmt: skip
    return ForeignCase(
        log_files(rng, STEP_S, recordings, noise_k, step_k, has_room=True), _belief(rng, name), truth
    )


def _draw_known(rng: Generator) -> dict[str, float]:
    """Draw walls without mass, films, contents, and what else acts."""
    also = {f"effects.{name}": 1.0 for name in BYSTANDERS if rng.random() < BYSTANDER_ODDS}
    return also | {
        "effects.wall_loss": 1.0,
        "effects.extra_capacity": 1.0,
        "cover.inner_film_w_m2_k": rng.uniform(7.0, 14.0),
        "cover.outer_film_w_m2_k": rng.uniform(5.0, 14.0),
        "soil.air_w_k": rng.uniform(1.5, 4.0),
        "air.contact_capacity_factor": rng.uniform(1.5, 6.0),
        "events.heat_noise_w": rng.uniform(0.5, 1.5),
    }


def _draw_hidden(rng: Generator, name: str) -> dict[str, float]:
    if not name:
        return {}
    own = SETTINGS[name]
    return {f"effects.{name}": 1.0, own.place: rng.uniform(own.low, own.high), **dict(own.also)}


def _draw_day(rng: Generator, rows: int, usual_c: float) -> ChamberDay:
    lamp = spells(
        rng, rows, STEP_S, (1200.0, 4800.0), lambda: 0.0 if rng.random() < 0.35 else rng.uniform(0.2, 1.0)
    )
    return ChamberDay(
        rng.uniform(7.0, 17.0), usual_c + rng.normal(0.0, 0.8), lamp.round(2), int(rng.integers(1 << 40))
    )


def _size_k(known: Settings, day: ChamberDay, run: Mapping[str, Floats]) -> float:
    """Return how far the run would be off without the effect, under the same commands."""
    duty, fan = run["heater_duty"], run["fan_on"]
    less = drive(known, day, lambda k, _: (duty[k], fan[k]))
    return float(np.sqrt(np.mean((run["clean_c"] - less["clean_c"]) ** 2)))


def _values(name: str, hidden: Settings) -> dict[str, float]:
    own = SETTINGS[name]
    return {own.parameter: float(hidden[own.place])} if own.parameter else {}


def _belief(rng: Generator, name: str) -> dict[str, Any]:
    """Return the owner's twin: of the paper's box, its loss, capacity and fan to be fitted."""
    fan = {} if name in OF_FAN else {"fan_effectiveness": {"eps_f": {"fit": True}}}
    loss, capacity = (
        {"fit": True, "start": round(float(rng.uniform(*ends)), 3)} for ends in ((1.0, 15.0), (1.0, 20.0))
    )
    return {
        "sample_s": STEP_S,
        "effects": {"wall_loss": {"UA": loss}, "extra_capacity": {"kC": capacity}, **fan},
        "sensor": {"quantisation_k": 0.0, "noise_sd_k": None},
        "nuisance": {"heater_power_run_sd": None, "heat_noise_sd_w": None},
    }
