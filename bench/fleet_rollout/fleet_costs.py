"""Hourly costs of a fleet's boxes under each bundle, from closed loops that run side by side.

The controller adds the heat that by its bundle's model follows the reference, and a proportional correction.
It has no integral, so that an error of the model shows in the cost; the runs with one, as a controller that
learns a disturbance has, tell what then remains.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.boxes.box import BoxDisturbances
from bench.boxes.draw import DEVELOPMENT, draw_box, scaled_reference, sibling
from bench.boxes.facts import BoxFacts
from bench.fleet_rollout.kind_model import KindModel, heat_for, learn_model
from bench.fleet_rollout.linear_boxes import STEP_S, LinearBox, LinearFleet, linear_box
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]
KINDS, OF_KIND = 3, 20
HOURS = 24 * 16
HOUR_STEPS = round(3600.0 / STEP_S)
# Shares of the loss of one kind, which the bad bundle's model does not know: the first that makes it bad. A
# bundle by which a kind is dearer by no more than the margin may pass.
LACKING = (0.25, 0.5, 0.75)
BAD = 0.25  # share by which the median box of the kind is dearer
RAMP_H = 3.0  # from night to day and back
LEARNT_FROM = (2, 20)  # boxes of a kind that the old bundle was made from, and the new one
BUNDLES = ("old", "good", "bad")
LEARNING = ("old, integral", "bad, integral")
AROUND_STEPS = 4  # for which rooms, sun and mains are held
FLEET_SALT = 23
LOOP_GAIN = 8.0  # of the correction at most: then a lasting error is a ninth of what it is without
DAMPING = 0.3
INTEGRAL_H = 1.0
COOL, WARM = (0.2, 0.35), (0.45, 0.6)  # references by night and by day, shares as of scaled_reference
DUTY_MAX = 0.85  # that a reference asks for at rest


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCosts:
    """Costs [boxes, hours] by bundle, mean of a step. kinds : of each box; bad_kind : hurt by "bad" """

    kinds: Sequence[str]
    bad_kind: str
    costs: Mapping[str, Floats]


def fleet_costs(seed: int, folder: Path | None = None) -> SimulatedCosts:
    """Return the costs of the fleet of a seed. folder : where they are kept; None: nowhere"""
    path = None if folder is None else folder / f"{seed}.npz"
    if path is not None and path.exists():
        with np.load(path) as kept:
            costs = {name: kept[name] for name in BUNDLES}
            return SimulatedCosts(kept["kinds"].tolist(), str(kept["bad_kind"]), costs)
    found = simulate(seed)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            kept_arrays = {"kinds": np.array(found.kinds), "bad_kind": np.array(found.bad_kind)}
            np.savez(file, allow_pickle=False, **kept_arrays, **dict(found.costs))
    return found


def simulate(seed: int, names: Sequence[str] = BUNDLES) -> SimulatedCosts:
    """Return the costs of the fleet of a seed: designs, boxes, rooms, people and noise are drawn from it.

    names : of BUNDLES and LEARNING
    """
    rng = np.random.default_rng([seed, FLEET_SALT])
    kinds = _draw_kinds(seed, rng)
    bad = list(kinds)[int(rng.integers(KINDS))]
    facts = [own for drawn in kinds.values() for own, _ in drawn[:OF_KIND]]
    boxes = [box for drawn in kinds.values() for _, box in drawn[:OF_KIND]]
    models: dict[str, list[KindModel]] = {name: [] for name in BUNDLES}
    for kind, drawn in kinds.items():
        others = drawn[OF_KIND:]
        old, new = (
            learn_model([box for _, box in own], [_mean_sun(facts, seed) for facts, _ in own])
            for own in (others[: LEARNT_FROM[0]], others[LEARNT_FROM[0] :])
        )
        models["old"] += [old] * OF_KIND
        models["good"] += [new] * OF_KIND
        models["bad"] += [new.lacking(LACKING[0]) if kind == bad else new] * OF_KIND
    around, reference = _surroundings(facts, seed), _references(facts, rng)
    # A person sets the proportional gain once for a kind: no bundle changes it.
    gains = np.repeat([damped_gain(drawn[OF_KIND][1]) for drawn in kinds.values()], OF_KIND)
    costs = {}
    for name in names:
        bundle, _, learns = name.partition(", ")
        costs[name] = closed_loop(
            FleetLoop(facts, boxes, models[bundle], gains, around, reference), bool(learns), seed
        )
    members = [kind for kind in kinds for _ in range(OF_KIND)]
    hurt = np.array(members) == bad
    for lacking in LACKING[1:]:
        if "bad" not in costs or np.median(_dearer(costs)[hurt]) > BAD:
            break
        worse = [
            model.lacking(lacking) if is_hurt else model
            for model, is_hurt in zip(models["good"], hurt, strict=True)
        ]
        costs["bad"] = closed_loop(FleetLoop(facts, boxes, worse, gains, around, reference), False, seed)
    if "good" in costs:
        _keep_better(np.array(members), bad, costs)
    return SimulatedCosts(members, bad, costs)


def _dearer(costs: Mapping[str, Floats]) -> Floats:
    """Return by which share the bad bundle is dearer than the old one, by box."""
    return np.asarray(costs["bad"].mean(axis=1) / costs["old"].mean(axis=1) - 1.0)


def _keep_better(members: NDArray[np.str_], bad: str, costs: dict[str, Floats]) -> None:
    """Leave a kind its old model where the new one is dearer, as who trains would; "good" is good by this."""
    for kind in dict.fromkeys(members.tolist()):
        own = members == kind
        if np.mean(costs["good"][own].mean(axis=1) / costs["old"][own].mean(axis=1)) > 1.0:
            costs["good"][own] = costs["old"][own]
            if kind != bad:
                costs["bad"][own] = costs["old"][own]


Drawn = tuple[BoxFacts, LinearBox]


def _draw_kinds(seed: int, rng: np.random.Generator) -> dict[str, list[Drawn]]:
    """Return kinds whose boxes can follow, each with the boxes that models are made from."""
    found: dict[str, list[Drawn]] = {}
    for design in rng.permutation(DEVELOPMENT).tolist():
        count = OF_KIND + sum(LEARNT_FROM)
        built = [_build(draw_box(design), 1000 * seed + k, rng) for k in range(count)]
        drawn = [(own, linear_box(own)) for own in built]
        if all(_can_follow(*each) for each in drawn):
            found[str(design)] = drawn
        if len(found) == KINDS:
            break
    return found


def _build(design: BoxFacts, number: int, rng: np.random.Generator) -> BoxFacts:
    """Build a box of a kind: its rooms are like the design's in draughts, and its gaps are as narrow."""
    draught, gaps = rng.uniform(0.85, 1.15, 2)
    return replace(
        sibling(design, number),
        draught_w_m2_k=draught * design.draught_w_m2_k,
        leak_m2=gaps * design.leak_m2,
    )


def damped_gain(box: LinearBox) -> float:
    """Return the largest proportional gain up to LOOP_GAIN times the loss that swings out soon [1/K]."""
    for share in (1.0, 0.5, 0.25, 0.125):
        gain = share * LOOP_GAIN / box.gains_k()[0]
        roots = np.log(np.linalg.eigvals(box.matrix - gain * np.outer(box.inputs[:, 0], box.felt)) + 0j)
        swinging = roots[np.abs(roots.imag) > 1e-6]
        if np.all(-swinging.real >= DAMPING * np.abs(swinging)):
            break
    return float(gain)


def _can_follow(facts: BoxFacts, box: LinearBox) -> bool:
    if not box.is_stable():
        return False
    low_c, high_c = scaled_reference(np.array([COOL[0], WARM[1]]), facts).tolist()
    return box.duty_at(low_c) > 0.0 and box.duty_at(high_c) < DUTY_MAX


def _mean_sun(facts: BoxFacts, seed: int) -> float:
    around = BoxDisturbances(facts, seed)
    return float(np.mean([around.sun_w_m2(3600.0 * hour) for hour in range(HOURS)]))


def _surroundings(facts: Sequence[BoxFacts], seed: int) -> Floats:
    """Return room [°C], sun [W/m²] and mains of each box at each step [boxes, steps, 3]."""
    times = ((np.arange(HOURS * HOUR_STEPS // AROUND_STEPS) + 0.5) * STEP_S * AROUND_STEPS).tolist()
    drawn = [BoxDisturbances(own, 100 * seed + k) for k, own in enumerate(facts)]
    return np.repeat([[each.at(time_s) for time_s in times] for each in drawn], AROUND_STEPS, axis=1)


def _references(facts: Sequence[BoxFacts], rng: np.random.Generator) -> Floats:
    """Return references, warm by day and cool by night, of each box at each step [boxes, steps + 1]."""
    hours = np.arange(HOURS * HOUR_STEPS + 1) / HOUR_STEPS % 24.0
    found = []
    for own in facts:
        begin, end = rng.uniform(5.0, 9.0), rng.uniform(17.0, 20.0)
        cool, warm = rng.uniform(*COOL), rng.uniform(*WARM)
        day = np.interp(hours, [begin, begin + RAMP_H, end, end + RAMP_H], [cool, warm, warm, cool])
        found.append(scaled_reference(day, own))
    return np.array(found)


@dataclass(frozen=True, slots=True, eq=False)
class FleetLoop:
    """A fleet in closed loop. gains : [boxes]; around : [boxes, steps, 3]; reference : [boxes, steps + 1]"""

    facts: Sequence[BoxFacts]
    boxes: Sequence[LinearBox]
    models: Sequence[KindModel]
    gains: Floats
    around: Floats
    reference: Floats


def closed_loop(loop: FleetLoop, learns: bool, seed: int) -> Floats:
    """Return the mean cost of a step in each hour [boxes, hours], by the paper's cost of what sensors show.

    learns : with an integral
    """
    facts, around, reference, gain = loop.facts, loop.around, loop.reference, loop.gains
    rng = np.random.default_rng([seed, FLEET_SALT, 1])
    fleet = LinearFleet(loop.boxes, around[:, 0, 0])
    step_k, noise_k = (
        np.array([getattr(own.air, name) for own in facts]) for name in ("step_k", "noise_sd_k")
    )
    room_c = seen_rooms(facts, around[:, :, 0])
    wanted = heat_for(loop.models, reference, room_c)
    cost, integral = np.empty_like(room_c), np.zeros(len(facts))
    shown = room_c[:, 0]
    for k in range(room_c.shape[1]):
        error = reference[:, k] - shown
        if learns:
            integral = np.clip(integral + gain * error / (INTEGRAL_H * HOUR_STEPS), -0.5, 0.5)
        wished = wanted[:, k] + gain * error + integral
        duty = np.round(np.clip(wished, 0.0, 1.0) * HEATER_LEVELS) / HEATER_LEVELS
        room, sun, mains = around[:, k].T
        fleet.step(np.column_stack((duty * mains, room, sun)))
        noisy = fleet.readings() + noise_k * rng.standard_normal(len(facts))
        shown = step_k * np.round(noisy / step_k)
        cost[:, k] = TRACKING_WEIGHT * (shown - reference[:, k + 1]) ** 2 + duty**2
    return np.asarray(cost.reshape(len(facts), HOURS, HOUR_STEPS).mean(axis=2))


def seen_rooms(facts: Sequence[BoxFacts], room_c: Floats) -> Floats:
    """Return the room as each rig knows it: by its sensor's bias, or the mean where it has none."""
    bias = np.array([own.room_sensor.bias if own.room_sensor else 0.0 for own in facts])
    has_sensor = np.array([own.room_sensor is not None for own in facts])
    mean = np.array([own.room.mean_c for own in facts])
    return np.asarray(np.where(has_sensor[:, None], room_c + bias[:, None], mean[:, None]))
