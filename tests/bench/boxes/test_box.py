"""A box behind the pins: the board and the daemon run it as they run the chamber."""

import numpy as np
import pytest

from bench.boxes.__main__ import box_reference, summary, tuning_courses
from bench.boxes.box import Box, BoxDisturbances
from bench.boxes.clairvoyant import WINDOW_S, _cost, relay_share, simc, tangent, tune_pid
from bench.boxes.draw import LOTS, draw_box
from edge.config.settings import Settings
from edge.controllers.twin_plan.linear_step import linear_step
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest
from firmware_protocol.messages import Capability
from firmware_protocol.virtual_board.board_config import PWM_SLOTS, BoardConfig
from firmware_protocol.virtual_board.board_outputs import SlowPwm
from firmware_protocol.virtual_board.core import BoardCore
from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.plant import ChamberModel, Plant
from firmware_protocol.virtual_board.store import Eeprom
from training.lab import InProcessBoard, Lab

PLAIN, DEAF = 4, 11  # seeds: a box with all sensors, and one without room and humidity
SLOT_S = WINDOW_S / PWM_SLOTS
DAYS = 300.0 * np.arange(2 * 288)  # two days [s]
WALL = {"wall_loss": {"UA": 3.0}, "extra_capacity": {"kC": 5.0}, "heater_lag": {"tau_h": 120.0}}
ROOM_C = 21.0


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


@pytest.mark.parametrize("steps", [0, 1, 12, PWM_SLOTS])
@pytest.mark.parametrize("part_slots", [1, 5])
def test_the_relay_is_closed_as_the_board_closes_it(steps: int, part_slots: int) -> None:
    pwm = SlowPwm(round(1000 * SLOT_S), steps=steps)
    closed = []
    for slot in range(3 * PWM_SLOTS):
        pwm.advance(round(1000 * SLOT_S * slot), steps)
        closed.append(pwm.relay)
    for begin in range(0, len(closed), part_slots):
        share = relay_share(steps / PWM_SLOTS, SLOT_S * begin, SLOT_S * part_slots)
        assert share == pytest.approx(sum(closed[begin : begin + part_slots]) / part_slots)


def test_the_future_is_the_same_whenever_it_is_asked_for() -> None:
    facts = draw_box(1)
    once, again = BoxDisturbances(facts, 5), BoxDisturbances(facts, 5)
    later = [once.at(t) for t in DAYS[::-1]][::-1]
    assert later == [again.at(t) for t in DAYS]
    other = BoxDisturbances(facts, 6)
    assert later != [other.at(t) for t in DAYS]


@pytest.mark.parametrize("seed", LOTS[0])
def test_a_room_swings_but_not_beyond_8_k(seed: int) -> None:
    facts = draw_box(seed)
    around = BoxDisturbances(facts, seed)
    room, sun, mains = np.array([around.at(t) for t in DAYS]).T
    assert 0.2 < np.ptp(room) <= 8.0
    assert room.min() > 8.0 and room.max() < 28.0
    assert (sun.max() > 0.0) == (facts.room.sun_peak_w_m2 > 0.0)
    assert sun.min() == 0.0  # the sun does not shine at night
    assert sun.max() <= 700.0
    assert np.abs(mains - 1.0).max() <= 0.03


def test_the_room_never_jumps() -> None:
    for seed in (1, 2, 106):
        around = BoxDisturbances(draw_box(seed), seed)
        room = np.array([around.room_c(float(t)) for t in range(0, 90_000, 10)])
        assert np.abs(np.diff(room)).max() < 0.1


def test_a_summary_compares_rows_of_one_rule():
    costs = [
        {"PID": 30.0, "MPC-Twin-P": 11.0, "clairvoyant": 10.0, "PID/early": 1.0, "MPC-Twin-P/early": 2.0},
        {"PID": 10.0, "MPC-Twin-P": 20.0, "clairvoyant": 15.0},
    ]
    lines = summary(costs)
    assert "MPC-Twin-P: by the limit 1.55 in the median, 2.00 in the worst" in lines[0]
    assert lines[0].endswith("ahead of every rival in 1 of 2")
    assert lines[1].endswith("2.00 in the worst; ahead of every rival in 0 of 1")


def test_the_tuned_pid_costs_less_than_the_rule_that_it_begins_with():
    twin, course = BoxTwin(effects=WALL), np.repeat([24.0, 30.0, 26.0], 60)
    rest = at_rest(twin, ROOM_C, ROOM_C)
    step = linear_step(twin, rest, ROOM_C, {})
    first, best = simc(twin, ROOM_C), tune_pid(twin, ROOM_C, [course], cools=True)
    both = np.array([first, (*best._gains, best._fan_on_k)])
    cost = _cost(step, both, rest, ROOM_C, course)
    assert cost[1] < 0.9 * cost[0]
    assert tune_pid(twin, ROOM_C, [course], cools=False)._fan_on_k > 1e3


@pytest.mark.parametrize("seed", [7, 510])
def test_the_clairvoyants_step_is_the_boxs_own_under_the_boards_pulses(seed):
    box = Box(draw_box(seed), seed)
    for time_s in range(300):
        box.step(1.0, _relay(time_s, 0.5), False, 0.0, False)
    fans = (0.0, 0.25, 1.0)
    step = tangent(box, 60.0, fans, 0.5)
    state = np.append(box.physics.reading_c(box.state), box.state[0])
    for place, fan in enumerate(fans):
        for duty in (0.4, 0.5, 0.6):
            told = step.matrix[place] @ state + step.constant[place] + step.now[place] * duty
            states = box.state
            for part in range(60):
                on, time_s = float(part < 60 * fan), box.time_s + part
                states = box.physics.step(states, time_s, 1.0, _relay(time_s, duty), on)
            near = 1e-6 if duty == 0.5 else 0.1
            assert told[0] == pytest.approx(float(box.physics.reading_c(states)[0]), abs=near)


def _relay(time_s: float, duty: float) -> float:
    return float(time_s % 20.0 < 20.0 * duty)


def test_the_tuning_of_the_pid_leaves_the_reference_that_it_is_driven_to(tmp_path):
    facts = draw_box(7)
    path = box_reference(facts, "reference_1", tmp_path)
    before = path.read_text()
    courses = tuning_courses(facts, tmp_path)
    assert len(courses) == 3
    assert path.read_text() == before
