"""Cases from the independent chamber: boxes with something hidden that matters by as much as is wanted.

What is known is calibrated on runs of a box without what is hidden.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.case_files import (
    FIRST_DAY,
    Sensing,
    as_list,
    declare_twin,
    draw_knowledge,
    draw_sensing,
    listed_or_missing,
    read_temps,
    run_of,
)
from bench.hidden_effects.cases import (
    SIZES_K,
    SUITES,
    HiddenCase,
    HiddenEffect,
    RunTruth,
    Truth,
    case_id,
    seed_of,
)
from bench.hidden_effects.chamber_box import (
    LEAD_ROWS,
    OUTSIDE,
    SETTINGS,
    THIN_WALLS,
    ChamberCalibration,
    DrivenRun,
    RunPlan,
    Setting,
    Settings,
    believed_c,
    calibrate,
    draw_base,
    draw_known,
    draw_sign,
    drive,
    quiet_c,
    read_off,
)
from bench.hidden_effects.equations_box import are_alike
from bench.hidden_effects.equations_cases import strength_for
from bench.hidden_effects.inputs import BEFORE_ROWS, Floats, draw_inputs, draw_surroundings
from edge.formats.run_file import RecordedRun

OPTIONAL = {
    "heater_lag": 0.3, "fan_effectiveness": 0.4, "soil_mass": 0.25, "infiltration": 0.25,
    "heater_efficiency": 0.25, "sensor_lag": 0.2, "constant_heat": 0.1, "led_gain": 0.1,
}  # fmt: skip
BARE_OPTIONAL = {
    **OPTIONAL, "ambient_offset": 0.15, "sensor_bias": 0.1, "heater_sag": 0.1, "heater_saturation": 0.1,
    "heater_deadtime": 0.1,
}  # fmt: skip
MOST_OPTIONAL = 2
GRID, GRID_RUNS, GRID_ROWS = 5, 2, 100  # runs and rows that a strength is searched on
CHECKED_RUNS = 3  # the last ones, tests among them
GLOWING = {"radiative_split", "sensor_radiation"}  # the element radiates, so its lag is not one number
Range = tuple[float, float]
CALIBRATION_ROWS, CALIBRATION_RUNS = 120, 2
LIT = {"led_gain", "evapotranspiration"}
ATTEMPTS = 80


@dataclass(frozen=True, slots=True)
class ChamberBox:
    """Settings of a box, what of it is hidden, and the settings of a box without that, for a calibration."""

    known: tuple[str, ...]
    settings: Settings
    calibration: Settings
    hidden: tuple[HiddenEffect, ...] = ()
    outside: HiddenEffect | None = None


def hide(
    rng: Generator, plans: Sequence[RunPlan], names: tuple[str, ...], wanted: Range
) -> ChamberBox | None:
    """Draw a box with these effects hidden, each of a size in `wanted`; None if it fails."""
    known, base = draw_known_box(rng, set(names))
    own: dict[str, Settings] = {}
    for name in names:
        found = _size(rng, SETTINGS[name], {**base, **_merge(own)}, plans, wanted)
        if found is None:
            return None
        own[name] = found
    return _check(known, base, own, plans, wanted)


def hide_outside(rng: Generator, plans: Sequence[RunPlan], name: str, wanted: Range) -> ChamberBox | None:
    """Draw a box with an effect of the chamber that no library knows."""
    known, base = draw_known_box(rng, {name})
    found = _size(rng, OUTSIDE[name][0], base, plans, wanted)
    if found is None:
        return None
    box = _check(known, base, {name: found}, plans, wanted)
    if box is None:
        return None
    effect = HiddenEffect(name, {key: float(value) for key, value in found.items()}, box.hidden[0].size_k)
    return ChamberBox(known, box.settings, base, (), effect)


def hide_all(rng: Generator, plans: Sequence[RunPlan], wanted: Range) -> ChamberBox | None:
    """Draw a box of 3 to 6 effects of which nothing is known."""
    names = ["wall_loss" if rng.random() < 0.5 else "wall_mass", "extra_capacity"]
    odds = np.array(list(BARE_OPTIONAL.values()))
    for name in rng.choice(list(BARE_OPTIONAL), rng.integers(1, 5), replace=False, p=odds / odds.sum()):
        if not are_alike({str(name), *names}):
            names.append(str(name))
    if len(names) < 3:
        return None
    base = draw_base(rng)
    return _check((), base, {name: draw_known(rng, name) for name in names}, plans, wanted)


def draw_pair(rng: Generator, first: str) -> tuple[str, ...]:
    """Return the first effect and another unlike it."""
    rest = [name for name in SETTINGS if name != first and not are_alike({first, name})]
    return first, str(rng.choice(rest))


def draw_known_box(rng: Generator, hidden: set[str]) -> tuple[tuple[str, ...], Settings]:
    """Names and settings of what is known."""
    names = [_way_out(rng, hidden), "extra_capacity"]
    names += ["infiltration"] if "evapotranspiration" in hidden else []  # else the box is soon full of vapour
    wanted = [name for name, odds in OPTIONAL.items() if rng.random() < odds]
    rng.shuffle(wanted)
    names += [name for name in wanted[:MOST_OPTIONAL] if _fits(name, hidden, names)]
    names = [name for name in names if name not in hidden]
    settings = draw_base(rng)
    if {"wall_loss", "longwave_radiation"} & hidden:
        settings |= {**THIN_WALLS, "cover.outer_film_w_m2_k": rng.uniform(2.0, 4.0)}
    for name in names:
        settings |= draw_known(rng, name)
    if "wall_loss" in hidden:
        settings["effects.longwave_radiation"] = rng.uniform(0.4, 0.7)
    if "wall_loss" in names and "longwave_radiation" in hidden:
        settings["cover.outer_film_w_m2_k"] = rng.uniform(2.0, 4.0)
    return tuple(names), settings


def _way_out(rng: Generator, hidden: set[str]) -> str:
    if "wall_loss" in hidden:
        return "longwave_radiation"
    if {"wall_mass", "longwave_radiation"} & hidden:
        return "wall_loss"
    return "wall_mass" if "radiative_split" in hidden or rng.random() < 0.5 else "wall_loss"


def _fits(name: str, hidden: set[str], names: Sequence[str]) -> bool:
    if name in names or name in hidden or are_alike({name, *hidden}):
        return False
    return name != "heater_lag" or not GLOWING & hidden


def _merge(own: dict[str, Settings]) -> Settings:
    return {key: value for settings in own.values() for key, value in settings.items()}


def _size(
    rng: Generator, setting: Setting, base: Settings, plans: Sequence[RunPlan], wanted: Range
) -> Settings | None:
    """Find the strength with the wanted size on a few rows."""
    few = [plan.shorten(GRID_ROWS) for plan in plans[-GRID_RUNS:]]
    sign, grid = draw_sign(rng), np.geomspace(setting.low, setting.high, GRID)
    without = _runs(base, few)
    sizes = np.array([_rms(_runs({**base, **setting.at(s, sign)}, few), without) for s in grid])
    strength = strength_for(rng, grid, sizes, wanted)
    return None if strength is None else setting.at(strength, sign)


def _check(
    known: tuple[str, ...],
    base: Settings,
    own: dict[str, Settings],
    plans: Sequence[RunPlan],
    wanted: Range,
) -> ChamberBox | None:
    """Return the box if each hidden effect matters as wanted among the others, over the last runs."""
    settings, last = {**base, **_merge(own)}, plans[-CHECKED_RUNS:]
    whole = _runs(settings, last) if own else np.zeros(0)
    true = read_off(list(own), settings)
    found = []
    for name in own:
        left = _merge({key: item for key, item in own.items() if key != name})
        kept = {"effects.wall_loss": 1.0} if name == "wall_mass" else {}
        size = _rms(whole, _runs({**base, **left, **kept}, last))
        if not wanted[0] <= size <= wanted[1]:
            return None
        found.append(HiddenEffect(name, true.get(name, {}), round(size, 4)))
    return ChamberBox(known, settings, base, tuple(sorted(found, key=lambda item: -item.size_k)))


def _runs(settings: Settings, plans: Sequence[RunPlan]) -> Floats:
    return np.concatenate([believed_c(settings, plan) for plan in plans])


def _rms(one: Floats, other: Floats) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))


def make_case(split: str, kind: str, number: int) -> HiddenCase:
    """Make the case of this number within its kind. Errors: RuntimeError if no box comes out as wanted"""
    seed = seed_of(split, kind, number)
    rng = np.random.default_rng([SUITES.index("chamber"), seed])
    for _ in range(ATTEMPTS):
        plans, tests = _draw_plans(rng, kind == "hard")
        box = _draw_box(rng, plans, kind, number)
        if box is None:
            continue
        return _case(rng, plans, tests, box, _calibration(rng, box), split, kind, seed)
    raise RuntimeError(f"chamber: {split} {kind} {number}: no box in {ATTEMPTS} draws")


def _draw_plans(rng: Generator, hard: bool) -> tuple[list[RunPlan], int]:
    """Draw runs in time's order, and the number of tests, which are the last ones."""
    trains, tests = (2, 1) if hard else (int(rng.integers(4, 6)), 2)
    shortest, longest = (100, 180) if hard else (150, 210)
    return _plans(rng, [int(rng.integers(shortest, longest + 1)) for _ in range(trains + tests)]), tests


def _plans(rng: Generator, rows: list[int]) -> list[RunPlan]:
    around = draw_surroundings(rng)
    inputs, (days, hours) = draw_inputs(rng, around, rows)
    return [
        RunPlan(
            duty=inputs.duty[BEFORE_ROWS - LEAD_ROWS : BEFORE_ROWS + count, b],
            fan=inputs.fan[BEFORE_ROWS - LEAD_ROWS : BEFORE_ROWS + count, b],
            light=inputs.light[BEFORE_ROWS - LEAD_ROWS : BEFORE_ROWS + count, b],
            day=float(days[b]),
            hour=float(hours[b]),
            room_c=float(inputs.ambient[BEFORE_ROWS, b]),
            seed=int(rng.integers(1 << 40)),
        )
        for b, count in enumerate(rows)
    ]


def _draw_box(rng: Generator, plans: list[RunPlan], kind: str, number: int) -> ChamberBox | None:
    """Effects take turns, so that each is hidden as often as another."""
    first = list(SETTINGS)[number % len(SETTINGS)]
    if kind == "outside":
        return hide_outside(rng, plans, list(OUTSIDE)[number % len(OUTSIDE)], SIZES_K[kind])
    if kind == "bare":
        return hide_all(rng, plans, SIZES_K[kind])
    if kind == "null":
        return hide(rng, plans, (), SIZES_K[kind])
    return hide(rng, plans, draw_pair(rng, first) if kind == "pair" else (first,), SIZES_K[kind])


def _calibration(rng: Generator, box: ChamberBox) -> ChamberCalibration:
    if not box.known:
        return ChamberCalibration({}, 0.0)
    rows = [CALIBRATION_ROWS] * CALIBRATION_RUNS
    plans = [plan.shorten(CALIBRATION_ROWS) for plan in _plans(rng, rows)]
    return calibrate(box.known, box.calibration, plans)


def _case(
    rng: Generator,
    plans: list[RunPlan],
    tests: int,
    box: ChamberBox,
    known: ChamberCalibration,
    split: str,
    kind: str,
    seed: int,
) -> HiddenCase:
    sensing = draw_sensing(rng, kind == "hard")
    heat_w = float(rng.uniform(0.5, 1.5))
    settings = _disturb(box, heat_w)
    driven = [drive(settings, plan) for plan in plans]
    # A box with an effect of the lamp has its light logged, or no one could name it.
    needed = bool(LIT & {*box.known, *(item.name for item in box.hidden)})
    lit = needed or rng.random() < 0.5
    first_test = len(plans) - tests
    runs = [
        _run(rng, plan, found, sensing, lit, "train" if b < first_test else "test")
        for b, (plan, found) in enumerate(zip(plans, driven, strict=True))
    ]
    named = {f"test_{i:02}.csv": b for i, b in enumerate(range(first_test, len(plans)), start=1)}
    nuisance = {"heater_power_run_sd": 0.015, "heat_noise_sd_w": round(heat_w, 3)}
    truth = Truth(
        id=case_id(seed),
        suite="chamber",
        split=split,
        kind=kind,
        seed=seed,
        hidden=box.hidden,
        outside=box.outside,
        depends_on=OUTSIDE[box.outside.name][1] if box.outside else (),
        known=box.known,
        effects={**known.effects, **read_off([item.name for item in box.hidden], box.settings)},
        noise={
            "sensor_sd_k": sensing.noise_k,
            "step_k": sensing.step_k,
            "misfit_of_known_k": known.rmse_k,
            **nuisance,
        },
        tests={
            name: RunTruth(
                listed_or_missing(runs[b].columns["temp_air_c"]),
                as_list(driven[b].clean_c),
                as_list(quiet_c({**box.settings, "effects.door_opening": 0.0}, plans[b])),
                {key: round(value, 4) for key, value in driven[b].start.items()},
            )
            for name, b in named.items()
        },
    )
    day0_utc = FIRST_DAY.timestamp() + 3600.0 * plans[0].hour
    return HiddenCase(
        truth,
        declare_twin(rng, known.effects, draw_knowledge(rng, kind == "weak"), sensing, nuisance, day0_utc),
        {f"train_{b + 1:02}.csv": runs[b] for b in range(first_test)},
        {name: runs[b] for name, b in named.items()},
        None,
    )


def _disturb(box: ChamberBox, heat_w: float) -> Settings:
    """Return the box with its disturbances; hidden ones stay as they are."""
    hidden_noise = box.outside is not None and box.outside.name == "heat_noise"
    return box.settings if hidden_noise else {**box.settings, "events.heat_noise_w": heat_w}


def _run(
    rng: Generator, plan: RunPlan, found: DrivenRun, sensing: Sensing, lit: bool, role: str
) -> RecordedRun:
    columns = {
        "temp_air_c": read_temps(rng, found.clean_c, sensing, role),
        "temp_ambient_c": found.shown["temp_ambient_c"],
        "heater_duty": plan.duty[LEAD_ROWS:],
        "fan_on": plan.fan[LEAD_ROWS:],
    }
    if lit:
        columns |= {name: found.shown[name] for name in ("light", "rel_humidity_pct")}
    return run_of(columns, role, plan.day, plan.hour)
