"""The fleets of `bench.fleet_rollout`: linearised boxes answer as boxes do, and a model holds a reference."""

from dataclasses import replace

import numpy as np
import pytest

from bench.boxes.draw import Still, draw_box, sibling
from bench.boxes.physics import BoxPhysics
from bench.fleet_rollout.kind_model import heat_for, learn_model
from bench.fleet_rollout.linear_boxes import LinearFleet, linear_box

DESIGN = 5


def test_a_linearised_box_answers_as_the_box_does() -> None:
    facts = sibling(draw_box(DESIGN), 1)
    room_c = facts.room.mean_c
    physics = BoxPhysics(facts, Still(room_c))
    state, box = physics.rest(room_c, 0.5), linear_box(facts)
    fleet = LinearFleet([box], np.array([room_c]))
    for _ in range(3000):  # until both rest at half power
        fleet.step(np.array([[0.5, room_c, 0.0]]))
    true, linear = [], []
    for step in range(120):
        duty = 0.55 if step < 60 else 0.45
        state = physics.step(state, 60.0 * step, 60.0, duty, 0.0)
        fleet.step(np.array([[duty, room_c, 0.0]]))
        true.append(float(physics.reading_c(state)[0]))
        linear.append(float(fleet.readings()[0]))
    assert np.ptp(true) > 0.5
    assert np.abs(np.array(true) - linear).max() < 0.03 * np.ptp(true)


def test_the_heat_of_a_model_holds_and_follows_a_reference_in_its_box() -> None:
    facts = sibling(draw_box(DESIGN), 1)
    room_c, box = facts.room.mean_c, linear_box(facts)
    model = learn_model([box], [0.0])
    reference = box.shown + np.concatenate((np.zeros(3000), np.linspace(0.0, 2.0, 181), np.full(600, 2.0)))
    room = np.full((1, len(reference) - 1), room_c)

    def errors(heat: np.ndarray) -> np.ndarray:
        fleet, found = LinearFleet([box], np.array([room_c])), []
        for share, wanted in zip(heat[0], reference[1:], strict=True):
            fleet.step(np.array([[share, room_c, 0.0]]))
            found.append(fleet.readings()[0] - wanted)
        return np.array(found)[2500:]

    assert np.abs(errors(heat_for([model], reference[None], room))).max() < 0.25
    lacking = errors(heat_for([replace(model, loss=0.75 * model.loss)], reference[None], room))
    # A quarter of the heat over the room is missing, so the box stays about a quarter of its rise colder.
    assert lacking[-1] == pytest.approx(-0.25 * (reference[-1] - room_c), rel=0.1)
