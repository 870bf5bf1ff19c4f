"""A box behind the pins: it steps, senses and repeats itself."""

from bench.boxes.box import Box
from bench.boxes.draw import draw_box


def test_a_heated_box_warms_up_and_says_so() -> None:
    box = Box(draw_box(4), seed=1)
    before = box.truth()["temp_air_c"]
    for _ in range(120):
        box.step(1.0, 1.0, False, 0.0, False)
    assert box.truth()["temp_air_c"] > before + 3.0
    assert abs(box.sense()["temp_air_c"] - box.truth()["temp_sensor_c"]) < 1.5
