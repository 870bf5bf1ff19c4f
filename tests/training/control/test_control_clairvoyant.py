"""The best that is possible: a chamber by arrays, its model of a minute, its search, its plan on a board."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.effects import Effects
from training.control.chamber_rows import ABSENT, ChamberRows
from training.control.clairvoyant import (
    ReferenceCourse,
    best_plan,
    held_plan,
    lagrange,
    plan_cost,
    relay_share,
)
from training.control.figures import figures
from training.control.job import ComparisonJob, run
from training.control.rig import entries

SEED = 102


def fresh() -> ChamberRows:
    return ChamberRows(*load(), SEED)


def course(weight: float = 1.0, target: str = "sensor", minutes: int = 20, **more: object) -> ReferenceCourse:
    reference = np.where(np.arange(minutes) < minutes // 2, 24.0, 27.0)
    return ReferenceCourse(reference, 1.0, 60.0, weight, target, **more)


def test_a_minute_later_the_state_is_a_parabola_in_the_duty():
    chamber, levels = fresh(), np.arange(21)
    boxes = chamber.start(21)
    for second in range(60):
        heat = relay_share(second, 1.0, levels)
        boxes = chamber.step(boxes, float(second), 1.0, heat, np.zeros(21))
    weights = lagrange(levels / 20.0)
    for values in (boxes.temps[0], chamber.air(boxes)):
        assert np.abs(weights @ values[[0, 10, 20]] - values).max() < 0.05


def test_the_relay_is_closed_for_its_duty():
    share = sum(relay_share(slot, 1.0, np.array([0, 7, 20])) for slot in range(20)) / 20.0
    np.testing.assert_allclose(share, [0.0, 0.35, 1.0])


def test_more_heat_has_to_wait_for_the_next_slot():
    new, before = np.array([7, 7, 0, 0]), np.array([0, 7, 7, 0])
    np.testing.assert_allclose(relay_share(1.0, 1.0, new, before), [0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(relay_share(1.0, 5.0, new, before), [0.8, 1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def best() -> float:
    """The cost of the usual plan."""
    return best_plan(fresh, course()).cost


def test_twice_the_beam_changes_next_to_nothing(best):
    wider = best_plan(fresh, course(), width=800, kind_k=0.25)
    assert abs(wider.cost / best - 1.0) < 0.005


def test_no_constant_plan_is_better(best):
    for level in (0, 3, 8):
        plan = np.full(20, level), np.zeros(20)
        assert best < plan_cost(fresh(), course(), *plan)


def test_a_penalty_saves_effort():
    free, spared = (best_plan(fresh, course(weight)) for weight in (0.0, 5.0))
    assert (spared.levels**2).sum() / 400.0 + spared.fan.sum() < (
        free.levels**2
    ).sum() / 400.0 + free.fan.sum()


def test_a_fan_for_parts_of_a_step_saves():
    whole, parts = (best_plan(fresh, course(whole=whole)) for whole in (True, False))
    assert set(whole.fan) <= {0.0, 1.0}
    assert not set(parts.fan) <= {0.0, 1.0}
    assert parts.cost < whole.cost


def test_who_knows_less_or_may_do_less_pays_more():
    free = best_plan(fresh, course(minutes=30, whole=True)).cost
    near = best_plan(fresh, course(minutes=30, whole=True, early_k=0.0)).cost
    held = held_plan(fresh, course(minutes=30, whole=True)).cost
    assert free < near < held


def test_what_the_present_reference_does_not_say_changes_no_command():
    ends = [np.repeat([24.0, after], [15, 5]) for after in (24.0, 28.0)]
    plans = [held_plan(fresh, ReferenceCourse(end, 1.0, 60.0, 1.0, "sensor"), width=30) for end in ends]
    np.testing.assert_array_equal(plans[0].levels[:15], plans[1].levels[:15])
    np.testing.assert_array_equal(plans[0].fan[:15], plans[1].fan[:15])
    assert (plans[0].levels[15:] != plans[1].levels[15:]).any()


def test_the_plan_costs_the_same_on_the_board(tmp_path, monkeypatch):
    monkeypatch.setattr("training.control.job.FOLDER", tmp_path)
    (tmp_path / "short.csv").write_text("time_s,reference_c\n0,24\n600,27\n1200,27\n")
    log = run(ComparisonJob(entries()["clairvoyant/sensor-P"], "short", SEED))
    planned = best_plan(
        fresh, ReferenceCourse(np.repeat([24.0, 27.0], 10)[:-1], 1.0, 60.0, 1.0, "sensor")
    ).cost
    assert figures(log).sensor_cost_1 == pytest.approx(planned, rel=0.02)
    assert log.changes == {}


WITHOUT_LAG = {"heater_lag": 0.0, "imperfect_mixing": 0.0}  # the element jumps, the two zones are one


@pytest.mark.parametrize(
    ("minutes", "changed"), [(60, {}), (10, WITHOUT_LAG)], ids=["as it is", "without lag"]
)
def test_many_boxes_move_as_one_chamber_each(minutes, changed):
    parameters, effects = load()
    effects = replace(effects, **changed)
    rng = np.random.default_rng(5)
    duty, fan = rng.integers(0, 21, (minutes, 3)) / 20.0, rng.integers(0, 2, (minutes, 3)).astype(float)
    chambers = [Chamber(parameters, effects, 7) for _ in range(3)]
    rows = ChamberRows(parameters, effects, 7)
    boxes, worst = rows.start(3), 0.0
    for second in range(minutes * 60):
        heat, on = duty[second // 60], fan[second // 60]
        for i, chamber in enumerate(chambers):
            chamber.step(1.0, heat[i], bool(on[i]), 0.0, False)
        boxes = rows.step(boxes, float(second), 1.0, heat, on)
        if second % 30 == 0:
            truths = [chamber.truth() for chamber in chambers]
            worst = max(worst, np.abs(rows.air(boxes) - [truth["temp_air_c"] for truth in truths]).max())
            sensors = [truth["temp_sensor_c"] for truth in truths]
            worst = max(worst, np.abs(boxes.sensor - sensors).max())
            elements = [truth["temp_heater_c"] for truth in truths]
            worst = max(worst, np.abs(boxes.temps[0] - elements).max())
    assert worst < 1e-9


@pytest.mark.parametrize("name", ABSENT)
def test_an_effect_that_the_copy_lacks_is_refused(name):
    parameters, _ = load()
    with pytest.raises(ValueError, match=name):
        ChamberRows(parameters, Effects(**{name: 1.0}), 1)
