"""Pilots over the columns of a body, and the cases of the bench of days."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.boxes.bodies import SAMPLES, BoxBody, TwinBody
from bench.boxes.days import CASES, FAULT_H, FaultCase
from bench.boxes.draw import draw_box
from bench.boxes.pilot import NOT_GOOD, Pilot, Task, fly
from edge.app.box import box_bounds
from edge.config.settings import SafetySettings, Settings
from edge.controllers.rules import Rules
from edge.twin.twin_file import TwinFile, read_twin_file

ROOM_C = 20.0
SETTINGS = replace(Settings(), safety=SafetySettings(energy_hour_max_wh=400.0, energy_day_max_wh=9600.0))


@pytest.fixture
def twin(tmp_path: Path) -> TwinFile:
    """40 W, 2 W/K, a time constant of six minutes."""
    path = tmp_path / "box.yaml"
    path.write_text(
        "geometry: {volume_m3: 0.05, heater_max_w: 40.0, fan_max_m3_s: 0.004}\n"
        "effects: {wall_loss: {UA: 2.0}, extra_capacity: {kC: 12.0}}\n"
    )
    return read_twin_file(path)


def flown(twin: TwinFile, hours: float, *tasks: Task) -> list[Pilot]:
    pilots = [Pilot(SETTINGS, box_bounds(twin), Rules(), task) for task in tasks]
    fly(TwinBody(twin.twin(), ROOM_C, True, 0.05, len(tasks)), pilots, 3600.0 * hours)
    return pilots


def hold(reference_c: float = 28.0, **more) -> Task:
    return Task(lambda time_s: reference_c, **more)


def test_a_healthy_twin_is_held_without_an_alarm(twin):
    (pilot,) = flown(twin, 4.0, hold())
    assert pilot.alarms == []
    assert abs(np.mean(pilot.off_by_k[60:])) < 1.5


def test_each_column_has_its_own_fault(twin):
    no_heat = frozenset({"safety.heater_no_effect"})
    dead, stuck, healthy, still = flown(
        twin, 3.0,
        hold(fault="heater_dead", fault_s=3600.0, right=no_heat),
        hold(fault="heater_stuck_on", fault_s=3600.0, off_s=3600.0, right=no_heat),
        hold(),
        hold(38.0, fault="sensor_stuck", fault_s=300.0, right=frozenset({NOT_GOOD})),
    )  # fmt: skip
    assert dead.named_s is not None and 0.0 < dead.named_s < 3600.0 and dead.wrong == []
    assert stuck.named_s is None and [key for _, key in stuck.wrong] == ["safety.heater_stuck_on"]
    assert healthy.alarms == []
    assert still.named_s is not None and still.named_s <= 1320.0  # bounds.yaml: sensor stuck at full heat


def test_a_twin_with_a_weaker_heater_is_less_warm(twin):
    bodies = [TwinBody(twin.twin(), ROOM_C, True, 0.0, 1, heat) for heat in (1.0, 0.85)]
    for _ in range(30):
        strong, weak = (body.pass_step(np.array([1.0]), np.array([0.0])).air[-1, 0] for body in bodies)
    assert (weak - ROOM_C) / (strong - ROOM_C) == pytest.approx(0.85)


def test_an_alarm_before_the_fault_is_wrong_even_with_the_right_name(twin):
    pilot = Pilot(SETTINGS, box_bounds(twin), Rules(), hold(fault_s=600.0, right=frozenset({NOT_GOOD})))
    pilot.alarms = [(300.0, NOT_GOOD), (900.0, NOT_GOOD), (1200.0, "safety.sensor_offset")]
    assert pilot.named_s == 300.0
    assert pilot.wrong == [(300.0, NOT_GOOD)]


def test_columns_of_a_box_differ_by_their_inputs_alone():
    body = BoxBody(draw_box(7), 7, 3)
    for _ in range(5):
        samples = body.pass_step(np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.5]))
    assert samples.air.shape == (SAMPLES, 3)
    assert samples.air[-1, 0] > samples.air[-1, 1] + 3.0
    assert samples.air[-1, 2] < samples.air[-1, 0]


def test_a_case_goes_over_to_its_end_when_the_fault_begins():
    facts = draw_box(5)
    task = FaultCase("", "fan_stuck_off", frozenset(), share=0.9, after=0.1, off=True).task(facts)
    assert task.fault_s == task.off_s == 3600.0 * FAULT_H
    assert task.reference_c(task.fault_s - 60.0) > task.reference_c(task.fault_s + 60.0) + 5.0


def test_a_box_without_a_fan_has_no_case_of_a_fan():
    without, with_fan = draw_box(13), draw_box(5)
    assert not any("fan" in case.fault for case in CASES if case.has_to(without))
    assert sum("fan" in case.fault for case in CASES if case.has_to(with_fan)) == 2
