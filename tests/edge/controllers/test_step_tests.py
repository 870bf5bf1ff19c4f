"""Step tests on small boxes of two masses, which nobody told the controller of."""

from dataclasses import replace

import numpy as np
import pytest
from contexts import context

from edge.controllers.step_tests import StepTests
from edge.core.controller import ControlLimits

STEP_S, HIGH_C, ROOM_C = 10.0, 35.0, 20.0


class SmallBox:
    """An element behind a lag, the air, and a wall; times and gains of the caller's choosing."""

    def __init__(self, lag_s: float, rise_k: float, tau_s: float) -> None:
        self.lag_s, self.rise_k, self.tau_s = lag_s, rise_k, tau_s
        self.heat, self.air, self.wall = 0.0, ROOM_C, ROOM_C

    def pass_step(self, duty: float, fan: float) -> None:
        for _ in range(int(STEP_S)):
            self.heat += (duty - self.heat) / max(self.lag_s, 1.0)
            settled = ROOM_C + self.rise_k * self.heat / (1.0 + 4.0 * fan)
            self.air += (0.7 * settled + 0.3 * self.wall - self.air) * (1.0 + 4.0 * fan) / self.tau_s
            self.wall += (self.air - self.wall) / (10.0 * self.tau_s)


def drive(tests: StepTests, box: SmallBox, minutes: float, limits: ControlLimits | None = None):
    """Air and commands of a run, [steps]."""
    airs, duties, fans, legs = [box.air], [], [], []
    now = context()
    for step in range(round(60.0 * minutes / STEP_S)):
        past = np.array(airs[-120:])
        seen = replace(
            now,
            now_s=STEP_S * step,
            step_s=STEP_S,
            history={**now.history, "temp_air": past},
            estimate=replace(now.estimate, temp_air=box.air, temp_ambient=ROOM_C),
            limits=limits or ControlLimits(),
        )
        decision = tests.decide(seen)
        command = decision.command
        box.pass_step(command.heater_duty, command.fan)
        airs.append(box.air)
        duties.append(command.heater_duty)
        fans.append(command.fan)
        legs.append(decision.why["leg"])
    return np.array(airs), np.array(duties), np.array(fans), legs


BOXES = {
    "quick": (0.0, 25.0, 60.0),
    "paper's": (150.0, 30.0, 900.0),
    "slow element": (500.0, 40.0, 600.0),
    "heavy": (300.0, 20.0, 7200.0),
    "weak": (60.0, 3.0, 600.0),
}


@pytest.mark.parametrize("name", BOXES)
def test_no_box_is_driven_beyond_the_band(name):
    airs, duties, _, _ = drive(StepTests(HIGH_C, True), SmallBox(*BOXES[name]), 120.0)
    assert airs.max() < HIGH_C + 0.7
    assert duties.max() == 1.0


@pytest.mark.parametrize("name", ["quick", "paper's", "slow element"])
def test_the_tests_use_the_band_the_levels_and_the_fan(name):
    airs, duties, fans, legs = drive(StepTests(HIGH_C, True), SmallBox(*BOXES[name]), 120.0)
    assert airs.max() > ROOM_C + 0.5 * min(HIGH_C - ROOM_C, BOXES[name][1])
    assert len(set(duties)) >= 5
    assert fans.any() and len(set(legs)) >= 8
    starts = ((fans > 0.0) & (np.append(0.0, fans[:-1]) < 1.0)).sum()
    assert starts <= 60


def longest_leg_s(legs, name):
    """Longest stretch of one leg [s]."""
    best = count = 0
    for before, leg in zip([None, *legs], legs, strict=False):
        count = count + 1 if leg == before else 1
        best = max(best, count) if leg.startswith(name) else best
    return best * STEP_S


@pytest.mark.parametrize(("name", "is_slow"), [("paper's", False), ("very heavy", True)])
def test_a_slow_box_gets_longer_legs(name, is_slow):
    box = SmallBox(*{**BOXES, "very heavy": (300.0, 20.0, 20_000.0)}[name])
    airs, _, _, legs = drive(StepTests(HIGH_C, True), box, 240.0)
    assert (longest_leg_s(legs, "full heat") > 1600.0) == is_slow
    assert (longest_leg_s(legs, "heat ") > 900.0) == is_slow
    assert airs.max() < HIGH_C


def test_the_fan_is_seen_alone_in_a_box_as_warm_as_its_room():
    airs, duties, fans, legs = drive(StepTests(HIGH_C, True), SmallBox(*BOXES["paper's"]), 60.0)
    alone = np.array(legs) == "fan at rest"
    assert alone.sum() == round(120.0 / STEP_S)
    assert fans[alone].all() and not duties[: alone.argmax() + 12].any()
    assert abs(airs[:-1][alone] - ROOM_C).max() < 0.5


def test_without_a_fan_none_is_driven():
    _, _, fans, _ = drive(StepTests(HIGH_C, False), SmallBox(*BOXES["paper's"]), 60.0)
    assert not fans.any()


def test_a_worn_relay_is_spared():
    _, _, fans, _ = drive(
        StepTests(HIGH_C, True), SmallBox(*BOXES["paper's"]), 90.0, ControlLimits(fan_starts=0)
    )
    assert not fans.any()


def test_the_same_seed_gives_the_same_tests_and_another_gives_others():
    runs = [drive(StepTests(HIGH_C, True, seed), SmallBox(*BOXES["paper's"]), 60.0)[1] for seed in (1, 1, 2)]
    assert (runs[0] == runs[1]).all() and (runs[0] != runs[2]).any()


def test_the_heaters_limit_is_kept():
    limits = ControlLimits(heater_max_duty=0.3)
    _, duties, _, _ = drive(StepTests(HIGH_C, True), SmallBox(*BOXES["paper's"]), 60.0, limits)
    assert duties.max() == 0.3


def decide(tests: StepTests, step: int, air: float):
    """One decision of tests that see this air."""
    now = context()
    seen = replace(
        now,
        now_s=STEP_S * step,
        step_s=STEP_S,
        history={**now.history, "temp_air": np.array([air])},
        estimate=replace(now.estimate, temp_air=air, temp_ambient=ROOM_C),
    )
    return tests.decide(seen)


def leg_of_the_random_part(tests: StepTests) -> int:
    """Drive tests until their legs are random ones; return the next step."""
    for step in range(3000):
        if str(decide(tests, step, 25.0).why["leg"]).startswith("heat "):
            return step + 1
    raise AssertionError("no random leg came")


def test_a_pause_drives_nothing_for_as_long_as_it_lasts():
    tests = StepTests(HIGH_C, True)
    step = leg_of_the_random_part(tests)
    tests.pause()
    for later in range(step, step + 400):
        decision = decide(tests, later, 18.0)
        assert (decision.command.heater_duty, decision.command.fan) == (0.0, 0.0)
        assert decision.why["leg"] == "pause"


def test_a_leg_that_hands_have_interrupted_is_repeated_after_the_box_has_settled():
    tests = StepTests(HIGH_C, True)
    step = leg_of_the_random_part(tests)
    leg, response = tests._leg, tests.response
    for _ in range(2):  # once in the leg, once while the box still settles
        tests.pause()
        decide(tests, step, 20.0)
        tests.go_on()
        assert decide(tests, step + 1, 20.0).why["leg"] == "settle"
    legs = [decide(tests, step + 2 + k, 25.0).why["leg"] for k in range(40)]
    assert legs[: legs.index(leg.name)] == ["settle"] * 29  # 300 s
    assert tests._leg is leg or leg.name in legs
    assert tests.response is response


def test_going_on_without_a_pause_changes_nothing():
    tests = StepTests(HIGH_C, True)
    decide(tests, 0, 20.0)
    tests.go_on()
    assert decide(tests, 1, 20.0).why["leg"] == "rest"
