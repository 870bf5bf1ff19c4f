"""The chamber by arrays is the chamber: step by step, over hours, with everything moving."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.effects import Effects
from training.control.chamber_rows import ABSENT, ChamberRows

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
