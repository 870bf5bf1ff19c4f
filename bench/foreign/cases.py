"""Cases: a box, its logs, what its owner believes of it, and the truth. Nothing is the engine's."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from bench.foreign.box import (
    AIR_J_KG_K,
    DRIVES,
    BoxWeather,
    ForeignBox,
    air_kg_m3,
    draw_control,
    draw_weather,
    drive,
    sun_w,
    visits_w,
)

Floats = NDArray[np.float64]
KINDS = {
    "null": 20, "single": 44, "pair": 22, "outside": 28, "lid": 8, "greenhouse": 32, "greenhouse_null": 20,
}  # fmt: skip
FIRST_SEEDS = {"dev": 0, "scored": 500_000}
SEEDS_PER_KIND = 1000
STEPS_S = (1, 2, 3, 5, 10, 15, 30, 60, 120, 300)
QUANTISED_K = (0.01, 0.0625, 0.1, 0.25, 0.5)
POWER_ON_C = 85.0  # what a DS18B20 shows before its first conversion (Maxim's data sheet, 19-7487)
GRID = np.exp(np.linspace(-0.7, 0.7, 9))  # of loss and capacity, to see what they can't stand for
# Shown: what no loss and no capacity stands for, at least so many times the sensor's noise, step and range.
SHOWN_NOISES, SHOWN_STEPS, SHOWN_SHARE = 1.5, 0.3, 0.02
# What no log of temperatures tells apart, or hardly.
ALIASES = (
    {"heater_lag", "sensor_lag", "heater_deadtime", "imperfect_mixing", "radiative_split"},
    {"soil_mass", "wall_mass"},
    {"wall_loss", "wall_mass"},
    {"heater_saturation", "heater_sag"},
    {"constant_heat", "ambient_offset", "sensor_bias", "ground_loss"},
    {"natural_convection", "longwave_radiation", "stack_ventilation"},
    {"fan_effectiveness", "short_circuit", "infiltration", "fan_heat"},
)
# Where in the box each acts, for localisation.
PLACES = {
    "heater": {"heater_lag", "heater_deadtime", "heater_saturation", "heater_sag", "heater_efficiency"},
    "bodies": {"soil_mass", "wall_mass", "extra_capacity"},
    "reading": {"sensor_lag", "sensor_bias", "imperfect_mixing"},
    "loss": {"wall_loss", "natural_convection", "longwave_radiation", "stack_ventilation", "infiltration"},
    "fan": {"fan_effectiveness", "short_circuit", "fan_heat", "fan_deadtime", "fan_spinup"},
    "heat": {"constant_heat", "ambient_offset", "ground_loss", "led_gain"},
}
HIDEABLE = (
    "heater_lag", "soil_mass", "sensor_lag", "wall_mass", "heater_deadtime", "imperfect_mixing",
    "heater_saturation", "constant_heat", "heater_sag", "fan_effectiveness", "infiltration",
)  # fmt: skip
OF_FAN = {"fan_effectiveness", "infiltration"}  # need one that changes the air
OUTSIDE = {
    "visits": ("none", "time"), "sun": ("time", "none"), "second_heater": ("temp_air",),
    "cutout": ("heater_duty", "temp_air"), "melting": ("temp_air",), "free_convection": ("temp_air",),
    "fan_heat": ("fan_on",),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ForeignLog:
    """Columns of one recording, and when the part begins that is judged; None: it is whole."""

    columns: Mapping[str, Floats]
    judged_from_s: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """True courses of a run, a number a row. fan : None where there is none; more : further columns"""

    room_c: Floats
    air_c: Floats
    duty: Floats
    fan: Floats | None
    more: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCase:
    """files : by name; twin : what the owner believes, as YAML; truth : as JSON"""

    files: Mapping[str, ForeignLog]
    twin: Mapping[str, Any]
    truth: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBox:
    """hidden : by effect, fields of the box; fan : exhaust, stirring or none"""

    box: ForeignBox
    tau_s: float
    step_s: float
    fan: str
    hidden: Mapping[str, Mapping[str, float]]


def seed_of(split: str, kind: str, number: int) -> int:
    """Errors: ValueError for a number that there is not."""
    if not 0 <= number < SEEDS_PER_KIND:
        raise ValueError(f"{kind}: case {number} is not in 0..{SEEDS_PER_KIND - 1}")
    return FIRST_SEEDS[split] + SEEDS_PER_KIND * list(KINDS).index(kind) + number


def attempt(rng: Generator, kind: str, number: int) -> ForeignCase | None:
    """Draw a case of a box; None where what is hidden does not show."""
    names = _names(rng, kind, number)
    outside = list(OUTSIDE)[number % len(OUTSIDE)] if kind == "outside" else ""
    drawn = _draw_box(rng, names, outside)
    rows = _rows(rng, drawn)
    runs, control_kind = [], str(rng.choice(DRIVES if not {"heater_saturation", "heater_sag"} & set(names)
                                            else ("steps", "climb")))  # fmt: skip
    rise_k = float(drawn.box.power_w) / float(drawn.box.loss_w_k)
    box = _with_outside(rng, drawn.box, outside, rise_k)
    usual_c = float(rng.uniform(12.0, 27.0))  # of the room
    for count in rows:
        weather = draw_weather(rng, count, drawn.step_s, float(box.power_w), usual_c)
        weather = _disturb(rng, weather, outside, kind, drawn)
        control = draw_control(
            rng,
            control_kind,
            count,
            drawn.step_s,
            drawn.tau_s,
            rise_k,
            float(weather.room_c[0]),
            drawn.fan != "none",
        )
        runs.append((weather, *drive(box, weather, control, drawn.step_s)))
    noise_k, step_k = float(rng.uniform(0.01, 0.12)), float(rng.choice(QUANTISED_K))
    shown = {name: _shown_k(box, fields, drawn, runs) for name, fields in drawn.hidden.items()}
    if outside:
        shown[outside] = _shown_outside_k(drawn.box, box, drawn, runs)
    span = float(np.mean([np.ptp(own[1]) for own in runs]))
    # An effect that does not show in the readings could be found by luck alone: such a box is drawn anew.
    least = max(SHOWN_NOISES * noise_k, SHOWN_STEPS * step_k, SHOWN_SHARE * span)
    if any(size < least for size in shown.values()):
        return None
    has_room = rng.random() > 1.0 / 3.0
    recordings = [
        Recording(weather.room_c, shown[:, 0], duty, None if drawn.fan == "none" else fan)
        for weather, shown, duty, fan in runs
    ]
    files = log_files(rng, drawn.step_s, recordings, noise_k, step_k, has_room)
    return ForeignCase(
        files, _belief(rng, drawn), _truth(drawn, outside, shown, noise_k, step_k, files, control_kind)
    )


def _names(rng: Generator, kind: str, number: int) -> tuple[str, ...]:
    if kind not in ("single", "pair"):
        return ()
    first = HIDEABLE[number % len(HIDEABLE)]
    if kind == "single":
        return (first,)
    rest = [name for name in HIDEABLE if not any({name, first} <= own for own in ALIASES) and name != first]
    return first, str(rng.choice(rest))


def _draw_box(rng: Generator, names: tuple[str, ...], outside: str) -> DrawnBox:
    volume = float(np.exp(rng.uniform(np.log(5e-4), 0.0)))
    loss = 6.0 * volume ** (2.0 / 3.0) * float(rng.uniform(0.6, 6.0))
    power = float(np.clip(loss * rng.uniform(8.0, 60.0), 2.0, 500.0))
    air = float(air_kg_m3(25.0)) * volume * AIR_J_KG_K
    contents = max(air * float(rng.uniform(1.0, 30.0)), 60.0 * loss)
    tau = (air + contents) / loss
    steps = [step for step in STEPS_S if 12.0 <= tau / step <= 80.0] or [STEPS_S[-1]]
    fan = "exhaust" if OF_FAN & set(names) else str(rng.choice(["none", "none", "exhaust", "stirring"]))
    if outside == "fan_heat" and fan == "none":
        fan = "stirring"
    flow = float(rng.uniform(0.5, 3.0)) * loss / (1.15 * AIR_J_KG_K) if fan == "exhaust" else 0.0
    box = ForeignBox(volume, power, loss, contents, flow_m3_s=flow, curve=float(rng.uniform(0.0, 0.02)))
    step_s = float(rng.choice(steps))
    hidden = {name: _strength(rng, name, box, tau, air + contents, step_s) for name in names}
    for fields in hidden.values():
        box = replace(box, **fields)
    return DrawnBox(box, tau, step_s, fan, hidden)


def _strength(
    rng: Generator, name: str, box: ForeignBox, tau: float, stores: float, step_s: float
) -> dict[str, float]:
    loss, power, u = float(box.loss_w_k), float(box.power_w), rng.uniform
    return {
        "heater_lag": lambda: {"element_s": min(tau * u(0.1, 0.8), 7000.0)},
        "heater_deadtime": lambda: {"dead_s": min(max(step_s * u(1.5, 6.0), tau * u(0.05, 0.2)), 590.0)},
        "sensor_lag": lambda: {"sensor_s": min(tau * u(0.08, 0.6), 3500.0)},
        "soil_mass": lambda: {"store_j_k": stores * u(1.0, 6.0), "store_w_k": loss * u(0.5, 3.0)},
        "wall_mass": lambda: {"wall_j_k": stores * u(1.0, 5.0)},
        "imperfect_mixing": lambda: {"mixing_w_k": loss * u(1.0, 4.0)},
        "heater_saturation": lambda: {"limit": u(0.45, 0.8)},
        "heater_sag": lambda: {"sag": u(0.2, 0.45)},
        "constant_heat": lambda: {"base_w": power * u(0.04, 0.2)},
        "fan_effectiveness": lambda: {"share": u(0.3, 0.7)},
        "infiltration": lambda: {"leak_m3_s": loss * u(0.3, 1.0) / (1.15 * AIR_J_KG_K)},
    }[name]()  # fmt: skip


def _library_values(name: str, fields: Mapping[str, float], box: ForeignBox) -> dict[str, float]:
    """Return the values by the library's names, where the meaning is the same."""
    loss = float(box.loss_w_k)
    own = dict(fields)
    found: dict[str, dict[str, float]] = {
        "heater_lag": {"tau_h": own.get("element_s", 0.0)},
        "heater_deadtime": {"d_h": own.get("dead_s", 0.0)},
        "sensor_lag": {"tau_s": own.get("sensor_s", 0.0)},
        "soil_mass": {"C_s": own.get("store_j_k", 0.0), "G_s": own.get("store_w_k", 0.0)},
        "wall_mass": {"C_w": own.get("wall_j_k", 0.0), "G_in": 2.0 * loss, "G_out": 2.0 * loss},
        "heater_saturation": {"u_sat": own.get("limit", 0.0)},
        "heater_sag": {"sag": own.get("sag", 0.0)},
        "constant_heat": {"P0": own.get("base_w", 0.0)},
        "fan_effectiveness": {"eps_f": own.get("share", 0.0)},
        "infiltration": {"F_inf": own.get("leak_m3_s", 0.0)},
    }
    return found.get(name, {})


def _rows(rng: Generator, drawn: DrawnBox) -> list[int]:
    """Draw the rows of each recording: one or several, the last one judged by."""
    total = int(np.clip(drawn.tau_s * rng.uniform(15.0, 40.0) / drawn.step_s, 240, 1500))
    count = int(rng.integers(1, 5))
    return [max(120, round(total / count))] * count


def _with_outside(rng: Generator, box: ForeignBox, name: str, rise_k: float) -> ForeignBox:
    power, stores = float(box.power_w), float(box.contents_j_k)
    if name == "second_heater":
        return replace(
            box, second_w=power * rng.uniform(0.15, 0.4), second_c=20.0 + rise_k * rng.uniform(0.1, 0.3)
        )
    if name == "cutout":
        opens = 20.0 + rise_k * rng.uniform(0.35, 0.6)
        return replace(box, cutout_c=opens, cutout_gap_k=rise_k * rng.uniform(0.04, 0.12))
    if name == "free_convection":
        return replace(box, free_w_k=float(box.loss_w_k) * rng.uniform(0.5, 1.2))
    if name == "fan_heat":
        return replace(box, fan_w=power * rng.uniform(0.06, 0.2))
    if name == "melting":
        melts = stores * rise_k * rng.uniform(0.3, 1.0)
        return replace(box, melts_j=melts, melts_c=20.0 + rise_k * rng.uniform(0.2, 0.5),
                       melts_over_k=max(1.0, 0.05 * rise_k))  # fmt: skip
    return box


def _disturb(rng: Generator, weather: BoxWeather, outside: str, kind: str, drawn: DrawnBox) -> BoxWeather:
    rows, power = len(weather.room_c), float(drawn.box.power_w)
    heat, lid = weather.heat_w, weather.lid
    if outside == "sun":
        heat = heat + sun_w(rng, rows, drawn.step_s, power * rng.uniform(0.2, 0.6), drawn.tau_s)
    if outside == "visits":
        heat = heat + visits_w(rng, rows, drawn.step_s, power * rng.uniform(0.06, 0.2), drawn.tau_s)
    if kind == "lid":
        lid = np.zeros(rows)
        for at in rng.integers(rows // 10, rows, max(2, rows // 150)):
            lid[at : at + max(1, round(drawn.tau_s * rng.uniform(0.1, 0.6) / drawn.step_s))] = rng.uniform(
                2.0, 8.0
            )
        lid = lid * float(drawn.box.loss_w_k)
    return replace(weather, heat_w=heat, lid=lid)


def _shown_k(box: ForeignBox, fields: Mapping[str, float], drawn: DrawnBox, runs: list[Any]) -> float:
    """Return the part of an effect that no other loss and capacity can replace, RMS of the first run [K]."""
    return _left_k(box.less(dict(fields)), drawn, runs)


def _shown_outside_k(plain: ForeignBox, box: ForeignBox, drawn: DrawnBox, runs: list[Any]) -> float:
    quiet = []
    for weather, *rest in runs:
        calm = np.zeros(len(weather.room_c))
        quiet.append((replace(weather, heat_w=calm), *rest))
    return _left_k(plain, drawn, runs, quiet)


def _left_k(less: ForeignBox, drawn: DrawnBox, runs: list[Any], others: list[Any] | None = None) -> float:
    weather, _, duty, fan = (others or runs)[0]
    losses, stores = (grid.ravel() for grid in np.meshgrid(GRID, GRID))
    many = replace(less, loss_w_k=less.loss_w_k * losses, contents_j_k=less.contents_j_k * stores)
    again = drive(many, weather, lambda k, _: (duty[k], fan[k]), drawn.step_s)[0]
    missed = runs[0][1][:, :1] - again
    return float(np.sqrt(np.mean((missed - missed.mean(axis=0) * 0.0) ** 2, axis=0)).min())


def log_files(
    rng: Generator, step_s: float, runs: Sequence[Recording], noise_k: float, step_k: float, has_room: bool
) -> dict[str, ForeignLog]:
    """Return the logs of a cheap logger, the last one judged; of one recording its last third."""
    files = {}
    drifts = rng.random() < 0.3
    for i, run in enumerate(runs):
        rows = len(run.duty)
        time_s: Floats = step_s * np.arange(rows, dtype=np.float64)
        air = run.air_c + rng.normal(0.0, noise_k, rows)
        if drifts:
            air += np.cumsum(rng.normal(size=rows)) * rng.uniform(0.02, 0.1) / np.sqrt(rows)
        air = np.round(air / step_k) * step_k
        # What cheap loggers do: a sensor's power-on value, and readings that stand still.
        if rng.random() < 0.15:
            air[rng.integers(5, rows, 2)] = POWER_ON_C
        if rng.random() < 0.1:
            at = int(rng.integers(5, rows - 15))
            air[at : at + 10] = air[at]
        columns = {"time_s": time_s, "temp_air_c": np.round(air, 4), "heater_duty": run.duty}
        if run.fan is not None:
            columns["fan_on"] = run.fan
        columns |= run.more
        if has_room:
            columns["temp_ambient_c"] = np.round((run.room_c + rng.normal(0.0, 0.08, rows)) / 0.25) * 0.25
        alone = len(runs) == 1
        role = "train" if alone or i < len(runs) - 1 else "test"
        files[f"{role}_{i + 1:02}.csv"] = ForeignLog(
            columns, float(time_s[round(0.65 * rows)]) if alone else None
        )
    return files


def _belief(rng: Generator, drawn: DrawnBox) -> dict[str, Any]:
    """Return the owner's twin: guesses, wrong by 30 %, or a fit from starts that are wrong by 10 times."""
    box = drawn.box
    air = 1.2 * 1005.0 * float(box.volume_m3)
    true = {"UA": float(box.loss_w_k), "kC": 1.0 + float(box.contents_j_k) / air}
    # The owner knows the box badly: a diagnosis that needs good starts would fail here.
    guessed = rng.random() < 0.5
    values: dict[str, Any] = {}
    for name, value in true.items():
        if guessed:
            least = 1.0 if name == "kC" else 0.0
            wrong = max(value * float(np.exp(0.3 * rng.normal())), least)
            values[name] = {"value": round(wrong, 5), "rel_sd": 0.3}
        else:
            start = value * float(rng.choice([0.1, 0.3, 3.0, 10.0]))
            low, high = (1.0, 1000.0) if name == "kC" else (0.001, 100.0)
            values[name] = {"fit": True, "start": round(float(np.clip(start, low, high)), 5)}
    geometry = {"volume_m3": float(f"{box.volume_m3:.4g}"), "heater_max_w": float(f"{box.power_w:.4g}")}
    if drawn.fan == "exhaust":
        geometry["fan_max_m3_s"] = float(f"{box.flow_m3_s:.4g}")
    fan = {}
    if drawn.fan == "exhaust" and "fan_effectiveness" not in drawn.hidden:
        fan = {
            "fan_effectiveness": {"eps_f": {"fit": True}}
        }  # a fan's plate says what it moves when it runs free
    return {
        "geometry": geometry,
        "fan_role": drawn.fan,
        "sample_s": drawn.step_s,
        "effects": {"wall_loss": {"UA": values["UA"]}, "extra_capacity": {"kC": values["kC"]}, **fan},
        "sensor": {"quantisation_k": 0.0, "noise_sd_k": None},
        "nuisance": {"heater_power_run_sd": None, "heat_noise_sd_w": None},
    }


def _truth(
    drawn: DrawnBox, outside: str, shown: Mapping[str, float], noise_k: float, step_k: float,
    files: Mapping[str, ForeignLog], control: str,
) -> dict[str, Any]:  # fmt: skip
    air = 1.2 * 1005.0 * float(drawn.box.volume_m3)
    order = sorted(drawn.hidden, key=lambda name: -shown[name])
    return {
        "hidden": {name: _library_values(name, drawn.hidden[name], drawn.box) for name in order},
        "outside": outside,
        "depends_on": list(OUTSIDE.get(outside, ())),
        "shown_k": {name: round(size, 4) for name, size in shown.items()},
        "known": {"UA": float(drawn.box.loss_w_k), "kC": 1.0 + float(drawn.box.contents_j_k) / air},
        "noise_k": noise_k,
        "step_k": step_k,
        "control": control,
        "fan": drawn.fan,
        "has_room": any("temp_ambient_c" in log.columns for log in files.values()),
        "tau_s": drawn.tau_s,
        "box": {name: value for name, value in asdict(drawn.box).items() if np.isfinite(value)},
    }
