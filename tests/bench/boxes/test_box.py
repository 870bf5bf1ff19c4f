"""A box behind the pins: the board and the daemon run it as they run the chamber."""

import numpy as np
import pytest

from bench.boxes.box import Box
from bench.boxes.draw import draw_box
from edge.config.settings import Settings
from firmware_protocol.messages import Capability
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.core import BoardCore
from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.plant import ChamberModel, Plant
from firmware_protocol.virtual_board.store import Eeprom
from training.lab import InProcessBoard, Lab

PLAIN, DEAF = 4, 11  # seeds: a box with all sensors, and one without room and humidity


def heated(box: ChamberModel, seconds: int = 120) -> ChamberModel:
    for _ in range(seconds):
        box.step(1.0, 1.0, False, 0.0, False)
    return box


def test_a_heated_box_warms_up_and_says_so() -> None:
    box = Box(draw_box(PLAIN), seed=1)
    before = box.truth()["temp_air_c"]
    heated(box)
    assert box.truth()["temp_air_c"] > before + 3.0
    sensed = box.sense()
    bias = box.facts.air.bias_k
    assert sensed["temp_air_c"] - bias == pytest.approx(box.truth()["temp_sensor_c"], abs=0.5)
    assert sensed["temp_ambient_c"] == pytest.approx(box.truth()["temp_ambient_c"], abs=0.8)


def test_the_same_seed_gives_the_same_readings_and_another_others() -> None:
    facts = draw_box(PLAIN)
    one, again, other = (heated(Box(facts, seed)).sense() for seed in (3, 3, 4))
    assert one == again != other


def test_a_second_look_shows_the_same() -> None:
    box = heated(Box(draw_box(PLAIN), seed=1))
    assert box.sense() == box.sense()


def test_readings_come_in_steps_and_with_noise() -> None:
    box = Box(draw_box(PLAIN), seed=1)
    shown = []
    for _ in range(200):
        box.step(1.0, 0.0, False, 0.0, False)
        shown.append(box.sense()["temp_air_c"])
    steps = np.array(shown) / box.facts.air.step_k
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    fine = Box(draw_box(6), seed=1)  # of 0.01 K
    looks = [heated(fine, 1).sense()["temp_air_c"] for _ in range(200)]
    assert 0.5 < np.std(np.diff(looks)) / np.sqrt(2.0) / fine.facts.air.noise_sd_k < 1.5


def test_absent_sensors_neither_speak_nor_are_announced() -> None:
    box = Box(draw_box(DEAF), seed=1)
    assert box.sense().keys() == {"temp_air_c"}
    assert not box.parts() & (Capability.TEMP_AMBIENT | Capability.HUMIDITY)
    assert Box(draw_box(PLAIN), 1).sense().keys() == {"temp_air_c", "temp_ambient_c", "rel_humidity_pct"}


def test_light_and_valve_change_nothing() -> None:
    dark, lit = (Box(draw_box(PLAIN), seed=1) for _ in range(2))
    dark.step(60.0, 0.5, True, 0.0, False)
    lit.step(60.0, 0.5, True, 1.0, True)
    assert dark.truth() == lit.truth()


def test_the_energy_of_a_box_is_balanced() -> None:
    box = heated(Box(draw_box(PLAIN), seed=1), 600)
    energy = box.energy()
    assert energy["in"] > 1e4
    assert energy["in"] == pytest.approx(energy["out"] + energy["stored"], rel=1e-6)


def plug(board: InProcessBoard, box: Box) -> InProcessBoard:
    """Return the board with its plant exchanged for a box."""
    config = BoardConfig(capabilities=box.parts())
    board.device = Device(lambda *boot: BoardCore(config, *boot), Plant(box, box.parts()), Eeprom(None), [])
    return board


@pytest.mark.parametrize("seed", [PLAIN, DEAF])
def test_the_daemon_heats_a_box_over_the_wire(seed: int) -> None:
    box = Box(draw_box(seed), seed=2)
    cold_c = box.truth()["temp_air_c"]
    settings = Settings()
    with Lab(settings, board="here", clock=lambda board: plug(board, box), with_truth=True) as lab:
        lab.run(minutes=6)
        columns = lab.columns()
    assert columns["heater_duty"].max() > 0.2
    assert np.isfinite(columns["temp_air_c"][1:]).all()
    assert columns["true_air_c"][-1] > cold_c + 0.5
    assert box.time_s == pytest.approx(360.0, abs=2.0)
