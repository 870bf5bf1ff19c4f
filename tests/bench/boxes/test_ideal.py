"""Readings in steps tell an interval each, and the parts that made an hour explain it."""

from dataclasses import replace

import numpy as np

from bench.boxes.draw import draw_box
from bench.boxes.ideal import Hour, simulate, told_between
from edge.formats.run_file import RecordedRun

DESIGN = 5


def test_a_mean_of_two_steps_tells_their_edge() -> None:
    low, high = told_between(np.array([21.0, 20.5 + 1.0 / 3.0, np.nan]), 0.5)
    assert np.allclose(low[:2], [20.75, 20.75])
    assert np.allclose(high[:2], [21.25, 20.75])
    assert np.isnan(low[2])
    assert np.isnan(high[2])


def test_only_the_parts_that_a_box_has_explain_its_hour() -> None:
    design = draw_box(DESIGN)
    assert design.room_sensor is not None
    time_s = 10.0 * np.arange(180)
    columns = {
        "time_s": time_s,
        "temp_air_c": np.zeros(180),
        "temp_ambient_c": np.full(180, 20.0 + design.room_sensor.bias),
        "heater_duty": np.where(time_s < 900.0, 0.0, 1.0),
        "fan_on": np.zeros(180),
    }
    usual = Hour(design, RecordedRun(columns))
    place = np.zeros(usual.size)
    place[0] = 1.5  # a stronger heater
    shown = simulate(usual.box(place), usual.run, np.full(180, 20.0), np.zeros(1), np.ones(1))
    step_k = design.air.step_k
    seen = step_k * np.round(shown / step_k)
    dark = replace(design, room=replace(design.room, sun_peak_w_m2=0.0))
    hour = Hour(dark, RecordedRun({**columns, "temp_air_c": seen}))

    def missed(z: np.ndarray) -> float:
        return float(np.abs(hour.misses(z)[: -hour.size]).max())

    assert missed(place) < 0.01
    assert missed(np.zeros(hour.size)) > 1.0
