"""Random boxes with something missing that matters by as much as is wanted."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import HiddenEffect
from bench.hidden_effects.draw_inputs import DrawnSurroundings, draw_inputs, draw_surroundings
from bench.hidden_effects.equations_box import (
    BARE_OPTIONAL,
    STRENGTHS,
    Effects,
    are_alike,
    draw_box,
    draw_effect,
    draw_others,
    series,
    size_effect,
)
from bench.hidden_effects.equations_inputs import Bend, ColumnInputs, Floats
from bench.hidden_effects.equations_outside import OUTSIDE
from bench.hidden_effects.equations_search import quiet, rms_k, strength_for, variants

GRID = 9
BODIES = {"wall_mass", "soil_mass"}  # that radiation warms
Range = tuple[float, float]


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
