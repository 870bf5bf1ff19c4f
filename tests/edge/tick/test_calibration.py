"""edge/tick/calibration.py: points, gain and offset, refusals, and what the loop makes of them."""

import json
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loop_rig import LoopRig

from edge.app.daemon import Daemon
from edge.app.replay import replay
from edge.config import loading as config
from edge.config.settings import CalibrationSettings, SensorCalibration
from edge.core.errors import DataError, RequestError
from edge.core.messages import Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.formats.run_file import RecordedRun
from edge.models.arx_file import read_arx
from edge.safety.supervisor import SafetyMemory
from edge.tick.calibration import (
    LIMITS,
    WINDOW_S,
    CalibrationChange,
    RawMinute,
    SensorDesk,
    StandingCalibration,
    in_force,
)
from edge.tick.loop import Loop
from edge.tick.orders import Desk, Operation, operate
from edge.tick.orders_json import from_dict, to_dict
from edge.tick.status import reply_json

GOOD = ReadingQuality.GOOD
NOW = 1000.0


class HeldSensor:
    """A signal whose raw readings a test sets; one sample a second."""

    def __init__(self, **raw: float) -> None:
        self.samples = {name: [value] * 60 for name, value in raw.items()}
        self.quality = GOOD
        self.newest_s = NOW

    def minute(self, signal: str) -> RawMinute:
        values = self.samples[signal]
        times = [self.newest_s - (len(values) - 1 - k) for k in range(len(values))]
        samples = [Reading(signal, *pair, GOOD) for pair in zip(values, times, strict=True)]
        reading = Reading(signal, values[-1] if values else None, self.newest_s, self.quality)
        return RawMinute(samples, reading, NOW, 1.0)


class Person:
    """Gives orders to a rig of sensors alone."""

    def __init__(self, sensor: HeldSensor, heats: bool = False, **configured: SensorCalibration) -> None:
        self.sensor, self.operation = sensor, Operation("MPC")
        self.configured = CalibrationSettings(**configured)
        sensors = SensorDesk(self.configured, sensor.minute, 40.0, heats)
        self.desk = Desk(1e9, ("MPC",), 15.0, 38.0, sensors=sensors)

    def order(self, do: str, signal: str, **more: Any) -> None:
        self.operation = operate(self.operation, {"do": do, "signal": signal, **more}, self.desk)

    def point(self, signal: str, raw: float, true_value: Any) -> None:
        self.sensor.samples[signal] = [raw] * 60
        self.order("calibrate_point", signal, true_value=true_value)

    def found(self, signal: str) -> SensorCalibration:
        found = getattr(in_force(self.configured, self.operation.calibrations), signal)
        assert isinstance(found, SensorCalibration)
        return found


def person(signal: str = "temp_air", raw: float = 22.0, **more: Any) -> Person:
    return Person(HeldSensor(**{signal: raw}), **more)


# arithmetic


def test_one_point_moves_the_offset_and_leaves_the_configured_gain() -> None:
    someone = person(temp_air=SensorCalibration(0.3, 1.05))
    someone.point("temp_air", 20.0, 20.5)
    someone.order("apply_calibration", "temp_air")
    assert someone.found("temp_air") == SensorCalibration(20.5 - 1.05 * 20.0, 1.05)
    assert someone.operation.points == ()


@pytest.mark.parametrize("order", [1, -1])
def test_two_points_give_back_the_gain_and_offset_that_a_sensor_has(order: int) -> None:
    someone = person()
    for true in (0.0, 38.0)[::order]:
        someone.point("temp_air", (true + 1.2) / 1.04, true)  # so that true = 1.04 * raw - 1.2
    someone.order("apply_calibration", "temp_air")
    found = someone.found("temp_air")
    assert (found.gain, found.offset) == (pytest.approx(1.04), pytest.approx(-1.2))


def test_a_second_calibration_takes_the_place_of_the_first() -> None:
    someone = person("rel_humidity", 50.0)
    for true in (60.0, 55.0):
        someone.point("rel_humidity", 50.0, true)
        someone.order("apply_calibration", "rel_humidity")
    assert someone.found("rel_humidity") == SensorCalibration(5.0, 1.0)
    assert len(someone.operation.calibrations) == 1


def test_signals_are_calibrated_each_by_itself_and_a_reset_gives_the_configured_one_back() -> None:
    someone = Person(HeldSensor(co2=450.0, soil_moisture=0.4), co2=SensorCalibration(7.0, 1.0))
    someone.point("co2", 450.0, 420.0)
    someone.point("soil_moisture", 0.4, 0.3)
    someone.order("discard_points", "soil_moisture")
    someone.order("apply_calibration", "co2")
    assert someone.found("co2") == SensorCalibration(-30.0, 1.0)
    someone.order("reset_calibration", "co2")
    assert someone.found("co2") == SensorCalibration(7.0, 1.0)
    for order, why in (
        ("reset_calibration", "follows the configuration already"),
        ("apply_calibration", "there is no calibration point"),
        ("discard_points", "there is no calibration point"),
    ):
        with pytest.raises(RequestError, match=why):
            someone.order(order, "co2")


def test_the_point_is_the_mean_of_noisy_readings_and_says_their_noise() -> None:
    noise, someone = random.Random(3), person()
    values = [round(22.0 + noise.gauss(0.0, 0.06), 1) for _ in range(60)]
    someone.sensor.samples["temp_air"] = values
    someone.order("calibrate_point", "temp_air", true_value=21.5)
    (point,) = someone.operation.points
    assert (point.raw, point.noise) == (pytest.approx(np.mean(values)), pytest.approx(np.std(values, ddof=1)))


def test_every_signal_has_limits_of_its_unit() -> None:
    assert {signal.unit for signal in SIGNALS.values()} == set(LIMITS)


# refusals


@pytest.mark.parametrize(
    ("signal", "raw", "true", "why"),
    [
        ("temp_air", 22.0, 72.0, r"too far from the reading of 22.00 °C: at most 5.00 °C. Is .* in °C"),
        ("temp_air", 0.5, 32.0, "too far"),  # ice water in °F
        ("temp_ambient", 22.0, 71.6, "above the largest allowed, 60"),
        ("temp_ambient", 15.0, 59.0, "too far"),
        ("rel_humidity", 45.0, 0.45, "too far"),
        ("co2", 800.0, 0.042, "too far"),  # in percent
        ("soil_moisture", 0.4, 40.0, "above the largest allowed, 1"),
        ("temp_air", 22.0, math.nan, "finite"),
        ("temp_air", 22.0, math.inf, "finite"),
        ("temp_air", 22.0, 10**400, "finite"),
        ("temp_air", 22.0, 1e300, "above"),
        ("temp_air", 22.0, "22", "must be a number"),
        ("temp_air", 22.0, True, "must be a number"),
        ("temp_air", 22.0, None, "must be a number"),
        ("temp_air", 22.0, [22.0], "must be a number"),
    ],
)
def test_a_value_that_cannot_be_true_is_refused(signal: str, raw: float, true: Any, why: str) -> None:
    someone = person(signal, raw)
    with pytest.raises(RequestError, match=why):
        someone.point(signal, raw, true)
    assert someone.operation == Operation("MPC")


@pytest.mark.parametrize("signal", ["temp_leaf", "", None, 5, ["temp_air"], {"a": 1}, "__class__"])
@pytest.mark.parametrize(
    "do", ["calibrate_point", "discard_points", "apply_calibration", "reset_calibration"]
)
def test_an_unknown_signal_is_refused(do: str, signal: Any) -> None:
    more = {"true_value": 1.0} if do == "calibrate_point" else {}
    with pytest.raises(RequestError, match="signal"):
        person().order(do, signal, **more)


@pytest.mark.parametrize("quality", [each for each in ReadingQuality if each is not GOOD])
def test_a_sensor_that_is_not_good_gives_no_point(quality: ReadingQuality) -> None:
    someone = person()
    someone.sensor.quality = quality
    with pytest.raises(RequestError, match=rf"not good \({quality.value}\)"):
        someone.point("temp_air", 22.0, 22.0)


def test_a_sensor_that_has_not_read_for_long_enough_gives_no_point() -> None:
    someone = person()
    someone.sensor.samples["temp_air"] = [22.0] * 20
    with pytest.raises(RequestError, match="20 good readings in the last 19 s are too few: wait until"):
        someone.order("calibrate_point", "temp_air", true_value=22.0)
    someone.sensor.samples["temp_air"] = [22.0] * 60
    someone.sensor.newest_s = NOW - WINDOW_S
    with pytest.raises(RequestError, match="0 good readings"):
        someone.order("calibrate_point", "temp_air", true_value=22.0)


@pytest.mark.parametrize(
    "values",
    [
        [22.0 + 0.01 * k for k in range(60)],  # it warms by 0.6 K in the minute
        [22.0] * 30 + [23.0] * 30,
        [22.0 + (k % 2) for k in range(60)],
        [22.0] * 59 + [80.0],
    ],
)
def test_unsteady_readings_give_no_point(values: list[float]) -> None:
    someone = person()
    someone.sensor.samples["temp_air"] = values
    with pytest.raises(RequestError, match="unsteady"):
        someone.order("calibrate_point", "temp_air", true_value=22.0)


@pytest.mark.parametrize(("every", "is_enough"), [(2, True), (3, False)])
def test_a_line_that_loses_half_of_the_readings_is_good_enough(every: int, is_enough: bool) -> None:
    someone = person()
    minute = someone.sensor.minute("temp_air")
    some = replace(minute, samples=minute.samples[::every])
    if is_enough:
        assert some.mean() == (22.0, 0.0)
        return
    with pytest.raises(RequestError, match="too few"):
        some.mean()


def test_nothing_heats_while_the_airs_sensor_may_be_out_of_the_box() -> None:
    with pytest.raises(RequestError, match=r"the heater is on, or .*: start maintenance"):
        person(heats=True).point("temp_air", 22.0, 22.0)
    person("co2", 450.0, heats=True).point("co2", 450.0, 420.0)


def test_two_points_must_be_apart_by_more_than_noise_and_a_third_is_refused() -> None:
    someone = person()
    someone.point("temp_air", 20.0, 20.0)
    with pytest.raises(RequestError, match=r"too close, 20.00 °C and 24.90 °C: they must be 5.00 °C apart"):
        someone.point("temp_air", 24.9, 25.0)
    someone.point("temp_air", 25.0, 25.0)
    with pytest.raises(RequestError, match="2 points already"):
        someone.point("temp_air", 30.0, 30.0)
    noisy = person("co2", 450.0)
    noisy.sensor.samples["co2"] = [450.0 + 35.0 * (-1) ** k for k in range(60)]
    noisy.order("calibrate_point", "co2", true_value=420.0)
    with pytest.raises(RequestError, match="706 ppm apart"):  # 20 times the noise of 35.3 ppm
        noisy.point("co2", 1000.0, 1000.0)


def test_swapped_points_are_refused_with_that_hint() -> None:
    someone = person("soil_moisture", 0.3)
    someone.point("soil_moisture", 0.3, 0.6)  # wet
    with pytest.raises(RequestError, match=r"soil_moisture.gain: .*swapped"):
        someone.point("soil_moisture", 0.6, 0.2)


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ([(20.0, 20.0), (25.0, 27.0)], "temp_air.offset: -8 is beyond the hard limit"),
        ([(70.0, 70.0), (76.0, 71.0)], "temp_air.gain"),
        ([(60.0, 60.0), (74.0, 74.0 - 1.5)], "temp_air.offset: 6.4.* is beyond the hard limit"),
    ],
)
def test_no_order_passes_the_hard_limits_of_the_air(points: list[tuple[float, float]], why: str) -> None:
    someone = person()
    *first, last = points
    for raw, true in first:
        someone.point("temp_air", raw, true)
    with pytest.raises(RequestError, match=why):
        someone.point("temp_air", *last)


def test_a_point_does_not_pass_them_by_a_gain_that_was_configured_later() -> None:
    someone = person()
    someone.point("temp_air", 60.0, 60.0)
    sensors = replace(someone.desk.sensors, configured=CalibrationSettings(SensorCalibration(0.0, 0.9)))
    someone.desk = replace(someone.desk, sensors=sensors)
    with pytest.raises(RequestError, match=r"temp_air\.offset: 6 is beyond the hard limit"):
        someone.order("apply_calibration", "temp_air")


def test_a_calibration_is_not_applied_where_it_would_trip_the_rig_or_show_nothing() -> None:
    someone = person()
    someone.point("temp_air", 36.0, 40.0)
    with pytest.raises(RequestError, match=r"it would read 40\.00 °C, and the limit is 40 °C"):
        someone.order("apply_calibration", "temp_air")
    someone.sensor.samples["temp_air"] = [35.9]
    someone.sensor.quality = ReadingQuality.STALE
    with pytest.raises(RequestError, match="no good reading now"):
        someone.order("apply_calibration", "temp_air")
    someone.sensor.quality = GOOD
    someone.order("apply_calibration", "temp_air")


@pytest.mark.parametrize(
    "values",
    [
        {"gain": 1.2},
        {"offset": 5.1},
        {"gain": math.nan},
        {"offset": "1"},
        {"signal": "temp_leaf"},
        {"gain": 0.0},
    ],
)
def test_a_state_file_cannot_defeat_safety(values: dict[str, Any]) -> None:
    document = to_dict(Operation("MPC", calibrations=(StandingCalibration("temp_air", 1.0, 0.5, 1.0),)))
    document["calibrations"][0] |= values
    with pytest.raises(DataError, match="calibrations"):
        from_dict(json.loads(json.dumps(document)))


def test_the_state_file_has_the_keys_only_where_they_are_needed() -> None:
    """Earlier software, which an upgrade may go back to, refuses a key that it does not know."""
    assert not {"points", "calibrations"} & to_dict(Operation("MPC")).keys()
    someone = Person(HeldSensor(co2=450.0, temp_air=22.0))
    someone.point("co2", 450.0, 420.0)
    someone.point("temp_air", 22.0, 21.0)
    someone.order("apply_calibration", "temp_air")
    assert from_dict(json.loads(json.dumps(to_dict(someone.operation)))) == someone.operation


def test_earlier_measurements_are_converted_exactly() -> None:
    change = CalibrationChange("temp_air", SensorCalibration(1.0, 1.05), SensorCalibration(-2.0, 0.95), 20.0)
    assert change.convert(1.05 * 33.0 + 1.0) == pytest.approx(0.95 * 33.0 - 2.0)
    assert change.jump == pytest.approx((0.95 * 20.0 - 2.0) - (1.05 * 20.0 + 1.0))


# the loop


@pytest.fixture
def rig() -> Iterator[LoopRig]:
    rig = LoopRig()
    yield rig
    rig.close()


CALIBRATE = {"do": "calibrate_point", "signal": "temp_air", "true_value": 25.0, "by": "Ann (page)"}
APPLY = {"do": "apply_calibration", "signal": "temp_air", "by": "Ann (page)"}


def calibrate(rig: LoopRig, true_value: float) -> None:
    """Calibrate the air by one point, with everything off, and go on."""
    rig.ask({"do": "set_mode", "mode": "off"})
    for _ in range(3):
        rig.tick()
    assert rig.ask({**CALIBRATE, "true_value": true_value})["ok"]
    assert rig.ask(APPLY)["ok"]
    rig.ask({"do": "set_mode", "mode": "auto"})


def test_a_point_is_of_the_last_minute_also_between_two_ticks(rig: LoopRig) -> None:
    rig.tick()
    assert "the heater is on" in rig.ask(CALIBRATE)["error"]
    rig.ask({"do": "maintenance", "minutes": 30})
    rig.board.temp_air = 24.0
    rig.clock.now_s += 30.0  # no tick since
    assert "unsteady" in rig.ask(CALIBRATE)["error"]
    rig.clock.now_s += 60.0
    reply = rig.ask(CALIBRATE)
    (point,) = reply["operation"]["points"]
    assert (point["raw"], point["noise"], point["true_value"]) == (24.0, 0.0, 25.0)
    shown = reply["calibration"]["temp_air"]
    assert (shown["reads"], shown["will_read"], shown["unit"]) == (24.0, 25.0, "°C")
    assert shown["following"] == {"gain": 1.0, "offset": 1.0}
    rig.board.link_up = False
    rig.clock.now_s += 30.0
    assert "not good (stale)" in rig.ask(CALIBRATE)["error"]


@pytest.mark.parametrize("duty", [0.0, 0.5])
def test_a_jump_of_five_kelvins_is_neither_fault_nor_heat(rig: LoopRig, duty: float) -> None:
    rig.chosen.command = replace(rig.chosen.command, heater_duty=duty)
    for _ in range(30):
        rig.tick()
    before = rig.tick()
    calibrate(rig, 27.0)
    keys = []
    for _ in range(120):
        record = rig.tick()
        keys += [event.key for event in record.events]
        assert record.readings["temp_air"] == Reading("temp_air", 27.0, record.time_s, GOOD)
        assert record.estimate.temp_air == pytest.approx(27.0, abs=0.6)
    assert before.readings["temp_air"].value == 22.0
    assert not [key for key in keys if key.startswith("safety.") or key == "reading.not_good"], keys
    measured = rig.rig.estimator.history()["temp_air_measured"]
    assert np.unique(measured) == 27.0  # rows before it are as the new calibration shows them


def test_a_calibration_down_is_no_proof_that_the_relay_is_off(rig: LoopRig) -> None:
    """Air that falls while the heater is off is that proof; see edge/safety/relay_proof.py."""
    for _ in range(10):
        rig.tick()
    rig.ask({"do": "set_mode", "mode": "off"})
    for _ in range(3):
        rig.tick()
    before = rig.loop._memory.thermal.proof
    rig.ask({**CALIBRATE, "true_value": 18.0})
    rig.ask(APPLY)
    rig.tick()
    after = rig.loop._memory.thermal.proof
    assert (before.highest_c, after.highest_c) == (22.0, 18.0)
    assert after.since_s > before.since_s > 0.0


def test_events_say_who_calibrated_what_and_from_when_on(rig: LoopRig) -> None:
    rig.tick()
    calibrate(rig, 21.5)
    record = rig.tick()
    told = {event.key: event.text for event in record.events}
    texts = [event.text for event in record.events]
    assert told["calibration.changed"] == (
        "temp_air is now 1 * reading - 0.50 °C, was 1 * reading + 0.00 °C: "
        "the sensor read 22.00 °C and reads 21.50 °C"
    )
    assert "the mean of raw readings was 22.00 °C, their noise 0.00 °C" in told["calibration.point"]
    assert "Calibrated by hand: temp_air. Points to apply: none. Ordered by Ann (page)." in texts
    rig.ask({"do": "reset_calibration", "signal": "temp_air"})
    assert rig.tick().readings["temp_air"].value == 22.0


def test_it_survives_a_power_cut(rig: LoopRig) -> None:
    rig.tick()
    calibrate(rig, 21.5)
    kept = from_dict(json.loads(json.dumps(to_dict(rig.saved[-1]))))
    rig.loop.close()
    rig.loop = Loop(rig.rig, kept, SafetyMemory(), first_seq=500)
    assert rig.tick().readings["temp_air"].value == 21.5
    assert rig.loop.status().calibration[0].utc == kept.calibrations[0].utc


def test_a_point_neither_acts_at_once_nor_hides_a_step_of_the_sensor(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 30})
    rig.tick()
    commands = len(rig.board.driven)
    rig.board.temp_air = 30.0  # a step: a reading that safety has to see
    rig.clock.now_s += 20.0
    assert not rig.ask(CALIBRATE)["ok"]
    assert len(rig.board.driven) == commands
    assert rig.tick(1.0).readings["temp_air"].quality is ReadingQuality.SPIKE


def test_an_experiment_keeps_to_the_calibration_and_to_one_made_meanwhile() -> None:
    standing = Operation("MPC", calibrations=(StandingCalibration("co2", 1.0, 30.0, 1.0),))
    daemon = Daemon(config.default(), None, experiment="rules")  # type: ignore[arg-type]
    own = daemon._orders(standing)
    assert (own.controller, own.calibrations) == ("rules", standing.calibrations)
    saved: list[Operation] = []

    class State:
        def save(self, operation: Operation, *_: object) -> None:
            saved.append(operation)

    newer = (StandingCalibration("co2", 1.0, -30.0, 2.0),)
    daemon._save(State(), standing)(replace(own, calibrations=newer), SafetyMemory())  # type: ignore[arg-type]
    assert saved == [replace(standing, calibrations=newer)]


def test_a_replay_does_not_correct_what_was_recorded_corrected() -> None:
    settings = replace(
        config.default(), calibration=CalibrationSettings(temp_air=SensorCalibration(-3.0, 1.0))
    )
    rows = 20
    columns = {
        "time_s": 60.0 * np.arange(rows),
        "temp_air_c": np.full(rows, 25.0),
        "temp_ambient_c": np.full(rows, 21.0),
        "heater_duty": np.zeros(rows),
        "fan_on": np.zeros(rows),
    }
    records = replay(RecordedRun(columns, {}, config.__file__), settings, read_arx(), False)  # type: ignore[arg-type]
    assert {record.readings["temp_air"].value for record in records} == {25.0}


def test_the_status_is_json(rig: LoopRig) -> None:
    rig.tick()
    reply = rig.ask({"do": "status"})
    assert json.loads(json.dumps(reply, allow_nan=False)) == reply
    assert set(reply["calibration"]) == {"temp_air", "temp_ambient"}
    rig.clock.now_s += 30.0  # no tick since
    assert rig.ask({"do": "status"})["calibration"]["temp_air"]["reads"] == 22.0
    rig.board.quality = ReadingQuality.FAULT
    rig.tick()
    assert set(reply_json({"ok": True, "status": rig.loop.status()})["calibration"]) == {"temp_ambient"}
