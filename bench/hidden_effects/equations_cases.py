"""Cases from the independent equations: a random box, what of it is hidden, runs, readings and the truth.

What is hidden matters by as much as is wanted: `strength_for` finds the strength at which an effect does it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.case_files import (
    FIRST_DAY,
    Sensing,
    as_list,
    declare_twin,
    draw_knowledge,
    draw_sensing,
    exact,
    listed_or_missing,
    read_ambient,
    read_humidity,
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
from bench.hidden_effects.equations import NEUTRAL, STATES, simulate
from bench.hidden_effects.equations_box import (
    BARE_OPTIONAL,
    LIT,
    OUTSIDE,
    STRENGTHS,
    Effects,
    are_alike,
    draw_box,
    draw_effect,
    draw_others,
    series,
    size_effect,
)
from bench.hidden_effects.inputs import (
    BEFORE_ROWS,
    Bend,
    ColumnInputs,
    DrawnSurroundings,
    Floats,
    draw_inputs,
    draw_surroundings,
)
from edge.formats.run_file import RecordedRun

MARGIN = 0.15
Parameters = Mapping[str, float]
GRID = 9
BODIES = {"wall_mass", "soil_mass"}  # that radiation warms
Range = tuple[float, float]
CURVE_ODDS, CURVE = 0.75, (0.02, 0.04)  # of a loss that grows with the difference, share per 10 K
ATTEMPTS = 80


def quiet(inputs: ColumnInputs) -> ColumnInputs:
    """Return the inputs without heat noise and with the mains as rated."""
    return replace(inputs, power=np.ones_like(inputs.power), heat_w=np.zeros_like(inputs.heat_w))


def variants(
    inputs: ColumnInputs, boxes: Sequence[Parameters], bend: Bend | None = None
) -> tuple[Floats, Floats]:
    """Simulate the same runs in several boxes: readings [V, N + 1, B] and states [V, N + 1, S, B]."""
    count = inputs.duty.shape[1]
    names = sorted({name for box in boxes for name in box})
    values = {name: np.repeat([box.get(name, NEUTRAL[name]) for box in boxes], count) for name in names}
    shown, states = simulate(values, inputs.columns(list(range(count)) * len(boxes)), bend=bend)
    by_box = shown.reshape(len(shown), len(boxes), count).transpose(1, 0, 2)
    return by_box, states.reshape(*states.shape[:2], len(boxes), count).transpose(2, 0, 1, 3)


def rms_k(difference: Floats, rows: Sequence[int]) -> Floats:
    """Over all recorded rows of all runs; difference : [..., N + 1, B]."""
    row = np.arange(difference.shape[-2])[:, None] - BEFORE_ROWS
    recorded = (row >= 0) & (row < np.asarray(rows))
    return np.asarray(np.sqrt((difference**2 * recorded).sum(axis=(-2, -1)) / recorded.sum()))


def strength_for(
    rng: Generator,
    strengths: Floats,
    sizes: Floats,
    wanted: tuple[float, float],
) -> float | None:
    """Draw a strength whose size is inside `wanted`, evenly on a logarithmic scale; None where there is none.

    sizes : at `strengths`, between which they are interpolated, so it keeps away from the ends
    """
    rising = np.maximum.accumulate(np.maximum(sizes, 1e-9))
    low, high = max(wanted[0] * (1.0 + MARGIN), rising[0]), min(wanted[1] / (1.0 + MARGIN), rising[-1])
    if not low < high or not np.isfinite(rising).all():
        return None
    target = np.exp(rng.uniform(np.log(low), np.log(high)))
    return float(np.exp(np.interp(np.log(target), np.log(rising), np.log(strengths))))


@dataclass(frozen=True, slots=True)
class Scene:
    """Runs of a case before anything is simulated: inputs, rows and starts [day, hour] of each column."""

    inputs: ColumnInputs
    rows: tuple[int, ...]
    starts: Floats
    around: DrawnSurroundings
    tests: tuple[int, ...]  # columns

    def size_k(self, difference: Floats, columns: tuple[int, ...] | None = None) -> Floats:
        """Root mean square over recorded rows, of all columns or some."""
        which = list(range(len(self.rows)) if columns is None else columns)
        return rms_k(difference[..., which], [self.rows[i] for i in which])


@dataclass(frozen=True, slots=True)
class EquationsBox:
    """A box, and what of it is hidden; `outside` with its bend where that is what is hidden."""

    known: Effects
    true: Effects
    hidden: tuple[HiddenEffect, ...] = ()
    outside: HiddenEffect | None = None
    bend: Bend | None = None


def draw_scene(rng: Generator, hard: bool) -> Scene:
    """4 to 8 runs of 150 to 400 rows and two tests; a hard case has two short runs and one test."""
    trains, tests = (2, 1) if hard else (int(rng.integers(4, 9)), 2)
    shortest, longest = (100, 180) if hard else (150, 400)
    rows = [int(rng.integers(shortest, longest + 1)) for _ in range(trains)]
    rows += [int(rng.integers(shortest, min(longest, 300) + 1)) for _ in range(tests)]
    around = draw_surroundings(rng)
    inputs, starts = draw_inputs(rng, around, rows)
    later = 1 + rng.choice(trains + tests - 1, tests, replace=False)  # the first day is not a test's
    return Scene(inputs, tuple(rows), starts, around, tuple(int(i) for i in sorted(later)))


def flat(effects: Effects) -> dict[str, float]:
    """Parameters of all effects together."""
    return {key: item for own in effects.values() for key, item in own.items()}


def adding(effects: Effects, name: str, own: Mapping[str, float]) -> Effects:
    """Return a box with one more effect; walls with mass replace those without."""
    left = {key: item for key, item in effects.items() if (name, key) != ("wall_mass", "wall_loss")}
    return {**left, name: dict(own)}


def without(effects: Effects, name: str) -> Effects:
    """Return a box without an effect; walls lose their mass and keep their conductance."""
    left = {key: item for key, item in effects.items() if key != name}
    return {**left, "wall_loss": {"UA": series(effects[name])}} if name == "wall_mass" else left


def hide(rng: Generator, scene: Scene, names: tuple[str, ...], wanted: Range) -> EquationsBox | None:
    """Draw a box with these effects hidden, each of a size in `wanted`; None if it fails."""
    others = {name: draw_others(rng, name) for name in names}
    known = draw_box(rng, others)
    true, inputs = known, quiet(scene.inputs)
    for name in names:
        grid = np.geomspace(STRENGTHS[name].low, STRENGTHS[name].high, GRID)
        boxes = [true, *(adding(true, name, size_effect(others[name], name, s)) for s in grid)]
        shown, _ = variants(inputs, [flat(box) for box in boxes])
        strength = strength_for(rng, grid, scene.size_k(shown[1:] - shown[0]), wanted)
        if strength is None:
            return None
        true = adding(true, name, size_effect(others[name], name, strength))
    return _check(scene, known, true, names, wanted)


def _check(
    scene: Scene, known: Effects, true: Effects, names: tuple[str, ...], wanted: Range
) -> EquationsBox | None:
    """Return the box if each hidden effect matters as wanted among the others, also in the tests alone."""
    boxes = [true, *(without(true, name) for name in names)]
    shown, _ = variants(quiet(scene.inputs), [flat(box) for box in boxes])
    sizes = scene.size_k(shown[1:] - shown[0])
    in_tests = scene.size_k(shown[1:] - shown[0], scene.tests)
    if not (np.all(sizes >= wanted[0]) and np.all(sizes <= wanted[1])):
        return None
    if not np.all(in_tests > 0.5 * wanted[0]):
        return None
    found = [
        HiddenEffect(name, true[name], round(float(size), 4)) for name, size in zip(names, sizes, strict=True)
    ]
    return EquationsBox(known, true, tuple(sorted(found, key=lambda item: -item.size_k)))


def hide_outside(rng: Generator, scene: Scene, name: str, wanted: Range) -> EquationsBox | None:
    """Draw a box with an effect that no library knows."""
    row, known = OUTSIDE[name], draw_box(rng, {})
    further, grid = row.draw_further(rng), np.geomspace(row.low, row.high, GRID)
    count = len(scene.rows)
    boxes = [flat(known)] * (GRID + 1)
    bend = row.bend(np.repeat([0.0, *grid], count), further)
    shown, _ = variants(quiet(scene.inputs), boxes, bend)
    strength = strength_for(rng, grid, scene.size_k(shown[1:] - shown[0]), wanted)
    if strength is None:
        return None
    bend = row.bend(np.repeat([0.0, strength], count), further)
    shown, _ = variants(quiet(scene.inputs), boxes[:2], bend)
    if scene.size_k(shown[1] - shown[0], scene.tests) < 0.5 * wanted[0]:
        return None
    size = round(float(scene.size_k(shown[1] - shown[0])), 4)
    parameters = {"strength": strength, "further": further}
    return EquationsBox(
        known, known, (), HiddenEffect(name, parameters, size), row.bend(np.array(strength), further)
    )


def hide_all(rng: Generator, scene: Scene, wanted: Range) -> EquationsBox | None:
    """Draw a box of 3 to 6 effects of the usual sizes, of which nothing is known."""
    names = ["wall_loss" if rng.random() < 0.5 else "wall_mass", "extra_capacity"]
    optional = list(BARE_OPTIONAL)
    odds = np.array(list(BARE_OPTIONAL.values()))
    for name in rng.choice(optional, rng.integers(1, 5), replace=False, p=odds / odds.sum()):
        if not are_alike({str(name), *names}):
            names.append(str(name))
    if len(names) < 3 or ("radiative_split" in names and not BODIES & set(names)):
        return None
    true = {name: draw_effect(rng, name) for name in names}
    return _check(scene, {}, true, tuple(names), wanted)


def draw_pair(rng: Generator, first: str) -> tuple[str, ...]:
    """Return the first effect and another unlike it."""
    rest = [name for name in STRENGTHS if name != first and not are_alike({first, name})]
    return first, str(rng.choice(rest))


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
