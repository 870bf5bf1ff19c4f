"""Cases from the independent equations: a random box, what of it is hidden, runs, readings and the truth."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import SIZES_K, SUITES, HiddenCase, RunTruth, Truth, case_id, seed_of
from bench.hidden_effects.declare import declare_twin, draw_knowledge, exact
from bench.hidden_effects.draw_inputs import BEFORE_ROWS
from bench.hidden_effects.draw_readings import (
    FIRST_DAY,
    Sensing,
    draw_sensing,
    read_ambient,
    read_humidity,
    read_temps,
    run_of,
)
from bench.hidden_effects.equations import STATES, simulate
from bench.hidden_effects.equations_box import LIT, STRENGTHS
from bench.hidden_effects.equations_hide import (
    EquationsBox,
    Scene,
    draw_pair,
    draw_scene,
    flat,
    hide,
    hide_all,
    hide_outside,
)
from bench.hidden_effects.equations_inputs import Floats
from bench.hidden_effects.equations_outside import OUTSIDE
from bench.hidden_effects.equations_search import quiet
from bench.hidden_effects.write_case import as_list, listed_or_missing
from edge.formats.run_file import RecordedRun

CURVE_ODDS, CURVE = 0.75, (0.02, 0.04)  # of a loss that grows with the difference, share per 10 K
ATTEMPTS = 80


def make_case(split: str, kind: str, number: int) -> HiddenCase:
    """Make the case of this number within its kind. Errors: RuntimeError if no box comes out as wanted"""
    seed = seed_of(split, kind, number)
    rng = np.random.default_rng([SUITES.index("equations"), seed])
    for _ in range(ATTEMPTS):
        scene = draw_scene(rng, kind == "hard")
        box = _draw_box(rng, scene, kind, number)
        if box is not None:
            return _case(rng, scene, box, split, kind, seed)
    raise RuntimeError(f"equations: {split} {kind} {number}: no box in {ATTEMPTS} draws")


def _draw_box(rng: Generator, scene: Scene, kind: str, number: int) -> EquationsBox | None:
    """Effects take turns, so that each is hidden as often as another."""
    first = list(STRENGTHS)[number % len(STRENGTHS)]
    if kind == "outside":
        return hide_outside(rng, scene, list(OUTSIDE)[number % len(OUTSIDE)], SIZES_K[kind])
    if kind == "bare":
        return hide_all(rng, scene, SIZES_K[kind])
    if kind == "null":
        return hide(rng, scene, (), SIZES_K[kind])
    names = draw_pair(rng, first) if kind == "pair" else (first,)
    return hide(rng, scene, names, SIZES_K[kind])


def _case(rng: Generator, scene: Scene, box: EquationsBox, split: str, kind: str, seed: int) -> HiddenCase:
    sensing = draw_sensing(rng, kind == "hard")
    curve = float(rng.uniform(*CURVE)) if rng.random() < CURVE_ODDS else 0.0
    clean, _ = simulate(_parameters(box, scene, curve), scene.inputs, bend=box.bend)
    # The same box without its door and its noise of heat: the most that any twin could foresee.
    still = replace(quiet(scene.inputs), door=np.zeros_like(scene.inputs.door))
    undisturbed, states = simulate(_parameters(box, scene, 0.0), still, bend=box.bend)
    lit = rng.random() < 0.5 or _needs_light(box)
    runs = [_run(rng, scene, b, clean[:, b], sensing, lit) for b in range(len(scene.rows))]
    trains = [b for b in range(len(runs)) if b not in scene.tests]
    test = {f"test_{i:02}.csv": b for i, b in enumerate(scene.tests, start=1)}
    around = scene.around
    nuisance = {"heater_power_run_sd": around.mains_sd, "heat_noise_sd_w": round(around.heat_w, 3)}
    truth = Truth(
        id=case_id(seed),
        suite="equations",
        split=split,
        kind=kind,
        seed=seed,
        hidden=box.hidden,
        outside=box.outside,
        depends_on=OUTSIDE[box.outside.name].depends_on if box.outside else (),
        known=tuple(box.known),
        effects=box.true,
        noise={
            "sensor_sd_k": sensing.noise_k,
            "step_k": sensing.step_k,
            "heat_tau_min": around.heat_tau_min,
            "ua_curve_per_10_k": curve,
            **nuisance,
        },
        tests={
            name: RunTruth(
                listed_or_missing(runs[b].columns["temp_air_c"]),
                as_list(_record(scene, b, clean[:, b])),
                as_list(_record(scene, b, undisturbed[:, b])),
                {key: round(float(states[BEFORE_ROWS, i, b]), 4) for i, key in enumerate(STATES)},
            )
            for name, b in test.items()
        },
    )
    day0_utc = (FIRST_DAY + timedelta(hours=float(scene.starts[1, 0]))).timestamp()
    has_drift = "ua_drift" in box.true
    return HiddenCase(
        truth,
        declare_twin(rng, box.known, draw_knowledge(rng, kind == "weak"), sensing, nuisance, day0_utc),
        {f"train_{i:02}.csv": runs[b] for i, b in enumerate(trains, start=1)},
        {name: runs[b] for name, b in test.items()},
        None if box.outside else exact(box.true, sensing, nuisance, day0_utc if has_drift else None),
    )


def _parameters(box: EquationsBox, scene: Scene, curve: float) -> Mapping[str, Floats]:
    count = len(scene.rows)
    return {name: np.full(count, value) for name, value in {**flat(box.true), "ua_curve": curve}.items()}


def _needs_light(box: EquationsBox) -> bool:
    words = OUTSIDE[box.outside.name].depends_on if box.outside else ()
    return bool({"light", "rel_humidity"} & set(words)) or any(name in box.true for name in LIT)


def _record(scene: Scene, b: int, values: Floats) -> Floats:
    """Return a column's recorded rows."""
    return values[BEFORE_ROWS : BEFORE_ROWS + scene.rows[b]]


def _run(rng: Generator, scene: Scene, b: int, clean: Floats, sensing: Sensing, lit: bool) -> RecordedRun:
    inputs, role = scene.inputs, "test" if b in scene.tests else "train"
    columns = {
        "temp_air_c": read_temps(rng, _record(scene, b, clean), sensing, role),
        "temp_ambient_c": read_ambient(rng, _record(scene, b, inputs.ambient[:, b])),
        "heater_duty": _record(scene, b, inputs.duty[:, b]),
        "fan_on": _record(scene, b, inputs.fan[:, b]),
    }
    if lit:
        columns["light"] = _record(scene, b, inputs.light[:, b])
        columns["rel_humidity_pct"] = read_humidity(rng, _record(scene, b, inputs.rel_humidity[:, b]))
    return run_of(columns, role, scene.starts[0, b], scene.starts[1, b])
