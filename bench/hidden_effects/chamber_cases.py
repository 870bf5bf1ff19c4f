"""Cases from the independent chamber: what is known is calibrated on runs of a box without what is hidden."""

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import SIZES_K, SUITES, HiddenCase, RunTruth, Truth, case_id, seed_of
from bench.hidden_effects.chamber_box import OUTSIDE, SETTINGS, Settings
from bench.hidden_effects.chamber_calibration import ChamberCalibration, calibrate, read_off
from bench.hidden_effects.chamber_hide import ChamberBox, draw_pair, hide, hide_all, hide_outside
from bench.hidden_effects.chamber_runs import LEAD_ROWS, DrivenRun, RunPlan, drive, quiet_c
from bench.hidden_effects.declare import declare_twin, draw_knowledge
from bench.hidden_effects.draw_inputs import BEFORE_ROWS, draw_inputs, draw_surroundings
from bench.hidden_effects.draw_readings import FIRST_DAY, Sensing, draw_sensing, read_temps, run_of
from bench.hidden_effects.write_case import as_list, listed_or_missing
from edge.formats.run_file import RecordedRun

CALIBRATION_ROWS, CALIBRATION_RUNS = 120, 2
LIT = {"led_gain", "evapotranspiration"}
ATTEMPTS = 80


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
