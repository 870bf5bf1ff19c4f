"""edge/lab/tclab.py, packaged.py: TCLab's calls over the twin, its own clock and historian, rules and PID."""

import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tclab

from edge.core.errors import RequestError
from edge.lab import TwinLab, clock, lab, labtime, setup
from edge.lab.box import PACKAGED_TWIN
from edge.lab.lab_time import LabTime
from edge.lab.packaged import PackagedController
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import at_rest

ROOT = Path(__file__).parents[3]


class FakeTime:
    """A machine whose time passes only while it waits."""

    def __init__(self) -> None:
        self.now = 100.0

    def time(self) -> float:
        return self.now

    def sleep(self, delay: float) -> None:
        self.now += delay


def course(box: TwinLab, minutes: int = 20, step: int = 10) -> list[float]:
    """Play a step test as a lesson has it; the air at each step."""
    temps = []
    for t in clock(60 * minutes, step):
        box.Q1(60 if t >= 60 else 0)
        box.Q2(100 if t >= 900 else 0)
        temps.append(box.T1)
    return temps


def test_a_step_test_warms_and_the_fan_cools():
    with lab() as box:
        temps = course(box)
    assert len(temps) == 121
    assert abs(np.mean(temps[:6]) - 21.0) < 0.1
    assert temps[90] > temps[30] > temps[10]
    assert temps[120] < temps[90]


def test_the_same_program_gives_the_same_readings():
    with lab(seed=1) as one, lab(seed=1) as same, lab(seed=2) as other:
        readings = []
        for _ in clock(1200, 10):
            readings.append((one.T1, same.T1, other.T1))
    first, again, another = np.array(readings).T
    assert np.array_equal(first, again)
    assert not np.array_equal(first, another)


def test_seconds_add_up_to_the_twins_own_steps():
    with lab(noise=False) as box:
        box.U1 = 60
        readings = [box.T1 for _ in clock(1800, 60)]
    twin = read_twin_file(PACKAGED_TWIN).twin()
    duty, fan = np.full((1, 30), 0.6), np.zeros((1, 30))
    expected = twin.rollout(at_rest(twin, 21.0, 21.0), duty, fan, 21.0)[0]
    assert np.abs(readings[1:] - expected).max() < 1e-9


def test_a_long_pause_is_as_good_as_many_short_ones():
    with lab(noise=False) as once, lab(noise=False) as often:
        once.Q1(50), often.Q1(50)
        for _ in clock(2 * 3600 + 30, 30):
            often.scan()
        assert abs(once.T1 - often.T1) < 1e-9


def test_commands_are_limited_and_returned():
    with lab() as box:
        assert (box.Q1(52), box.Q1(120), box.Q1(-3), box.Q1(math.nan)) == (50.0, 100.0, 0.0, 0.0)
        assert (box.Q2(52), box.Q2(120), box.Q2(-3)) == (52.0, 100.0, 0.0)
        assert (box.LED(), box.LED(300)) == (100.0, 100.0)
        box.U1, box.U2 = 30, 70
        assert (box.U1, box.U2) == (30.0, 70.0)
        assert box.scan() == (box.T1, box.T2, 30.0, 70.0)


@pytest.mark.parametrize(("percent", "is_on"), [(49.9, False), (50.0, True)])
def test_a_relay_is_on_from_half_on(percent, is_on):
    with lab(ambient_c=15.0, noise=False) as still, lab(ambient_c=15.0, noise=False) as blown:
        still.Q1(80), blown.Q1(80)
        blown.Q2(percent)
        labtime.sleep(1200)
        assert (still.T1 - blown.T1 > 0.5) is is_on


def test_a_fan_with_a_speed_takes_its_share(tmp_path: Path):
    path = tmp_path / "twin.yaml"
    path.write_text("fan_control: speed\n" + PACKAGED_TWIN.read_text())
    labs = [TwinLab(path, noise=False) for _ in range(3)]
    for box, percent in zip(labs, (0, 30, 100), strict=True):
        box.Q1(80), box.Q2(percent)
    labtime.sleep(1200)
    still, slow, fast = (box.T1 for box in labs)
    assert still > slow + 0.5 > fast + 1.0


def test_everything_is_off_after_the_block_also_after_an_error():
    with pytest.raises(KeyError), lab() as box:
        box.Q1(100), box.Q2(100)
        raise KeyError
    assert box.scan()[2:] == (0.0, 0.0)


def test_the_room_may_move():
    with lab(ambient_c=lambda t: 20.0 + t / 600.0, noise=False) as box:
        labtime.sleep(3000)
        assert box.T2 == 25.0
        assert 20.0 < box.T1 < 25.0


def test_only_a_twin_with_a_lamp_feels_the_light(tmp_path: Path):
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {wall_loss: {UA: 4.0}, led_gain: {P_led: 15.0}}\n")
    with TwinLab(path, noise=False) as lit, TwinLab(noise=False) as other:
        lit.LED(100), other.LED(100)
        labtime.sleep(3600)
        assert abs(lit.T1 - (21.0 + 15.0 / 4.0)) < 0.01  # the lamp's heat over the loss
        assert other.T1 == 21.0
    labtime.sleep(7200)
    assert abs(lit.T1 - 21.0) < 0.01  # it is off after the block


def test_a_reading_is_the_same_within_a_second_and_the_truth_has_no_steps():
    with lab() as box:
        box.Q1(50)
        labtime.sleep(600)
        first, true = box.T1, box.true_temp_c
        labtime.sleep(0.4)
        assert first == box.T1
        assert 0.0 < abs(first - true) < 0.3


def test_time_passes_with_the_machines_at_a_speed():
    machine = FakeTime()
    own = LabTime(machine.time, machine.sleep)
    own.set_rate(60.0)
    box = TwinLab(time=own, noise=False)
    box.Q1(100)
    machine.sleep(10.0)  # as a lesson that calls time.sleep does
    assert own.time() == pytest.approx(600.0)
    assert box.T1 > 22.0
    assert list(clock(120, 60, source=own)) == [0, 60, 120]
    assert machine.now == pytest.approx(112.0)


def test_the_clock_goes_as_tclabs_does():
    assert list(clock(3)) == [0, 1, 2, 3]
    assert list(clock(1, 0.3)) == [0, 0.3, 0.6, 0.9]
    with pytest.raises(RequestError, match="a step of 0 s"):
        next(clock(10, 0))
    with pytest.raises(RequestError, match="speed: -1"):
        lab(speed=-1)


def test_setup_knows_the_twin_alone():
    with setup(connected=False)(ambient_c=18.0) as box:
        assert pytest.approx(18.0, abs=0.2) == box.T2
    with pytest.raises(RequestError, match="only the twin"):
        setup(connected=True)


def test_tclabs_historian_logs_it():
    with lab() as box:
        historian = tclab.Historian(box.sources)
        for t in clock(300, 60):
            box.Q1(50)
            historian.update(t)
    assert historian.columns == ["Time", "T1", "T2", "Q1", "Q2"]
    assert historian.t == [0, 60, 120, 180, 240, 300]
    assert historian.logdict["Q1"] == [50.0] * 6
    assert historian.logdict["T1"][-1] > historian.logdict["T1"][0]


def test_tclabs_clock_drives_it(monkeypatch):
    machine = FakeTime()
    module = sys.modules["tclab.labtime"]  # the name `tclab.labtime` is the object in it
    monkeypatch.setattr(module, "time", SimpleNamespace(time=machine.time, sleep=machine.sleep))
    monkeypatch.setattr(module.labtime, "_rate", 1)
    tclab.labtime.reset()
    with TwinLab(time=tclab.labtime, noise=False) as box:
        temps = []
        for _ in tclab.clock(1200, 60):
            box.Q1(50)
            temps.append(box.T1)
    assert len(temps) == 21
    assert temps[-1] > temps[0] + 2.0


def test_a_lesson_for_tclab_gives_what_its_own_model_gives_in_kind():
    """The same lines over both: names, kinds and directions agree, the numbers are those of another box."""
    machine = FakeTime()
    module = sys.modules["tclab.labtime"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "time", SimpleNamespace(time=machine.time, sleep=machine.sleep))
        tclab.labtime.reset()
        theirs = tclab.TCLabModel()
        ours = TwinLab(time=tclab.labtime)
        for box in (theirs, ours):
            assert box.Q1(100) == 100
            machine.sleep(600)
            assert box.T1 > box.T2
            assert [name for name, _ in box.sources] == ["T1", "T2", "Q1", "Q2"]
            assert len(box.scan()) == 4
            box.close()
            assert box.Q1() == 0


def test_the_lab_needs_neither_gymnasium_nor_scipy():
    blocked = "sys.modules.update(dict.fromkeys(('gymnasium', 'scipy', 'torch', 'tclab')))"
    program = f"import sys; {blocked}; from edge.lab import lab; print(lab().Q1(50))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "50.0"


@pytest.mark.parametrize("name", ["rules", "PID"])
def test_a_controller_brings_the_box_to_its_reference_and_back(name):
    controller, errors = PackagedController(name), []
    with lab() as box:
        for t in clock(3 * 3600, 60):
            reference = 28.0 if t < 7200 else 25.0
            command = controller(t, box.T1, box.T2, reference)
            box.Q1(100 * command.heater_duty)
            box.Q2(100 * command.fan)
            errors.append(box.T1 - reference)
    # Rules swing by up to 3 K: the heater's element is still hot when they turn it off.
    assert np.mean(np.abs(errors[60:120])) < 2.0
    assert np.mean(np.abs(errors[150:])) < 2.0


def test_an_unknown_air_is_not_heated():
    command = PackagedController("PID")(0.0, float("nan"), 21.0, 28.0)
    assert (command.heater_duty, command.fan_on) == (0.0, False)


def test_a_controller_that_needs_a_model_is_refused():
    with pytest.raises(RequestError, match="MPC: not a controller without a model; known: rules, PID"):
        PackagedController("MPC")
