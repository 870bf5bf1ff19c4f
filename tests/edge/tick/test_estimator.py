"""edge/tick/estimator.py. The plant is an ARX with known noise, so that every variance is known."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from edge.config.settings import EstimatorSettings
from edge.core.messages import Command, Estimate, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.models.arx import Arx
from edge.tick.estimator import HISTORY_ROWS, Estimator

pytestmark = pytest.mark.slow

SETTINGS = EstimatorSettings(measurement_sd_k=0.1, process_sd_k=0.05, offset_sd_k=0.01)
STEADY = replace(SETTINGS, offset_sd_k=1e-6)  # for a plant whose disturbance does not wander
ONE_LAG = Arx(np.array([0.9]), np.array([2.0]), np.array([-1.5]), 0.1, 0.0, 60.0)
THREE_LAGS = Arx(
    np.array([1.1, -0.15, -0.05]), np.array([2.0, -1.0, 0.1]), np.array([-1.5, 1.0, 0.0]), 0.1, 0.0, 60.0
)
ROOM_C = 21.0


def readings(
    air: float | None, now: float, quality: ReadingQuality = ReadingQuality.GOOD, **others: float
) -> dict[str, Reading]:
    values = {"temp_air": air, "temp_ambient": ROOM_C, **others}
    found = {name: Reading(name, value, now, ReadingQuality.GOOD) for name, value in values.items()}
    return found | {"temp_air": Reading("temp_air", air, now, quality)}


def make(model: Arx = ONE_LAG, settings: EstimatorSettings = SETTINGS) -> Estimator:
    return Estimator(settings, model, 60.0, ROOM_C)


@dataclass
class ArxPlant:
    """The ARX with process noise and a disturbance; remembers what an ARX needs."""

    model: Arx
    rng: np.random.Generator
    disturbance: float = 0.0

    def __post_init__(self) -> None:
        rows = self.model.rows_needed
        self.temps = [24.0] * rows
        self.heater, self.fan = [0.0] * rows, [0.0] * rows

    def measure(self) -> float:
        return self.temps[-1] + self.rng.normal(0.0, SETTINGS.measurement_sd_k)

    def step(self, command: Command) -> None:
        self.heater[-1], self.fan[-1] = command.heater_duty, float(command.fan_on)
        history = {"temp_air": self.temps, "heater_duty": self.heater, "fan_on": self.fan}
        arrays = {name: np.array(column, dtype=float) for name, column in history.items()}
        controls = np.array([[[self.heater[-1], self.fan[-1]]]])
        after = self.model.rollout(arrays, controls, {"temp_ambient": np.array([ROOM_C])})[0, 0]
        noise = self.rng.normal(0.0, SETTINGS.process_sd_k)
        self.temps.append(float(after) + self.disturbance + noise)
        self.heater.append(math.nan)
        self.fan.append(math.nan)


def run(
    estimator: Estimator, plant: ArxPlant, ticks: int, gaps: range = range(0)
) -> list[tuple[Estimate, float]]:
    """Estimates and true temperatures; no measurement in the ticks of `gaps`."""
    result = []
    for tick in range(ticks):
        now = 60.0 * tick
        measured = readings(plant.measure(), now)
        if tick in gaps:
            measured = readings(None, now, ReadingQuality.FAULT)
        result.append((estimator.update(measured, now, 1e9 + now), plant.temps[-1]))
        command = Command(float(plant.rng.integers(0, 21)) / 20, bool(plant.rng.random() < 0.3))
        estimator.record_sent(command)
        plant.step(command)
    return result


def innovation_sd(estimate: Estimate) -> float:
    """From the variance p after a correction by a measurement of variance r: s = r² / (r - p)."""
    r = SETTINGS.measurement_sd_k**2
    return math.sqrt(r * r / (r - estimate.temp_air_sd**2))


@pytest.mark.parametrize("model", [ONE_LAG, THREE_LAGS], ids=["one lag", "three lags"])
def test_normalised_innovations_are_standard_normal(model):
    estimates = run(make(model, STEADY), ArxPlant(model, np.random.default_rng(1)), 1500)[100:]
    normalised = np.array([e.innovation / innovation_sd(e) for e, _ in estimates])
    assert abs(normalised.mean()) < 0.08  # 3 / sqrt(1400)
    assert abs(normalised.std() - 1.0) < 0.06
    assert abs(np.corrcoef(normalised[1:], normalised[:-1])[0, 1]) < 0.08
    assert 0.025 < np.mean(np.abs(normalised) > 2.0) < 0.07


@pytest.mark.parametrize("model", [ONE_LAG, THREE_LAGS], ids=["one lag", "three lags"])
def test_errors_have_the_size_the_filter_claims(model):
    estimates = run(make(model, STEADY), ArxPlant(model, np.random.default_rng(2)), 1500)[100:]
    normalised = np.array([(e.temp_air - true) / e.temp_air_sd for e, true in estimates])
    assert abs(normalised.std() - 1.0) < 0.06
    assert estimates[-1][0].temp_air_sd < SETTINGS.measurement_sd_k


@pytest.mark.parametrize("disturbance", [0.2, -0.3])
def test_the_offset_converges_to_a_constant_disturbance(disturbance):
    plant = ArxPlant(THREE_LAGS, np.random.default_rng(3), disturbance)
    offsets = [e.offset for e, _ in run(make(THREE_LAGS), plant, 400)[100:]]
    assert np.mean(offsets) == pytest.approx(disturbance, abs=0.02)
    assert np.std(offsets) < 0.06


def test_with_the_offset_the_prediction_has_no_steady_error():
    plant = ArxPlant(ONE_LAG, np.random.default_rng(4), disturbance=0.5)
    innovations = [e.innovation for e, _ in run(make(), plant, 600)[200:]]
    assert abs(np.mean(innovations)) < 0.02


def test_the_first_sample_starts_the_filter():
    estimate = make().update(readings(25.0, 0.0), 0.0, 0.0)
    assert (estimate.temp_air, estimate.offset, estimate.time_s) == (25.0, 0.0, 0.0)
    assert estimate.innovation is None
    assert estimate.temp_air_sd == pytest.approx(SETTINGS.measurement_sd_k)


@pytest.mark.parametrize(
    ("value", "quality"),
    [(None, ReadingQuality.FAULT), (25.0, ReadingQuality.STALE),
     (25.0, ReadingQuality.STUCK), (math.nan, ReadingQuality.GOOD),
     (math.inf, ReadingQuality.GOOD), (None, ReadingQuality.GOOD)],
)  # fmt: skip
def test_before_a_good_measurement_there_is_no_number(value, quality):
    estimator = make()
    estimate = estimator.update(readings(value, 0.0, quality), 0.0, 0.0)
    assert math.isnan(estimate.temp_air)
    assert estimate.temp_air_sd == math.inf
    assert estimate.time_s == -math.inf
    assert len(estimator.history()["temp_air"]) == 0


def test_no_reading_at_all_is_no_measurement():
    assert math.isnan(make().update({}, 0.0, 0.0).temp_air)


@pytest.mark.parametrize("bad", [None, math.nan, math.inf, -math.inf])
def test_without_a_measurement_the_model_goes_on_and_the_doubt_grows(bad):
    estimator = make()
    estimator.update(readings(25.0, 0.0), 0.0, 0.0)
    estimator.record_sent(Command(heater_duty=1.0))
    first = estimator.update(readings(bad, 60.0), 60.0, 60.0)
    estimator.record_sent(Command())
    second = estimator.update(readings(bad, 120.0), 120.0, 120.0)
    assert first.temp_air == pytest.approx(0.9 * 25.0 + 2.0 + 0.1 * ROOM_C)
    assert first.innovation is None and second.innovation is None
    assert SETTINGS.measurement_sd_k < first.temp_air_sd < second.temp_air_sd
    assert first.time_s == second.time_s == 0.0


@pytest.mark.parametrize("step_s", [10.0, 60.0, 180.0])
@pytest.mark.parametrize(("process_sd", "wander_sd"), [(0.0001, 0.1), (5.0, 1e-6)])
def test_the_doubt_after_an_hour_does_not_depend_on_the_step(step_s, process_sd, wander_sd):
    minutes, start_sd = 60.0, 0.1  # [min], [K/min]
    settings = EstimatorSettings(measurement_sd_k=0.001, process_sd_k=process_sd, offset_sd_k=wander_sd)
    keeps_heat = Arx(np.array([1.0]), np.array([0.0]), np.array([0.0]), 0.0, 0.0, step_s)
    estimator = Estimator(settings, keeps_heat, step_s, ROOM_C)
    estimate = estimator.update(readings(25.0, 0.0), 0.0, 0.0)
    for step in range(1, round(minutes * 60.0 / step_s) + 1):
        estimator.record_sent(Command())
        estimate = estimator.update(readings(None, step * step_s), step * step_s, 0.0)
    # A rate that starts unknown and wanders, integrated over the hour, and noise on the temperature itself.
    variance = (start_sd * minutes) ** 2 + wander_sd**2 * minutes**3 / 3.0 + process_sd**2 * minutes
    assert estimate.temp_air_sd == pytest.approx(math.sqrt(variance), rel=0.08)


def test_after_a_gap_the_errors_still_have_the_size_the_filter_claims():
    errors = []
    for seed in range(80):
        plant = ArxPlant(THREE_LAGS, np.random.default_rng(seed))
        estimate, true = run(make(THREE_LAGS, STEADY), plant, 40, gaps=range(30, 40))[-1]
        errors.append((estimate.temp_air - true) / estimate.temp_air_sd)
    assert 0.75 < np.std(errors) < 1.2


def test_an_open_door_teaches_the_offset_little():
    estimator = make()
    plant = ArxPlant(ONE_LAG, np.random.default_rng(5))
    run(estimator, plant, 200)
    before = estimator.update(readings(plant.temps[-1], 12000.0), 12000.0, 0.0).offset
    after = estimator.update(readings(plant.temps[-1] - 8.0, 12060.0), 12060.0, 0.0)
    assert after.innovation < -5.0
    assert abs(after.offset - before) < 0.1


def test_ticks_that_were_missed_are_predicted_with_everything_off():
    estimator = make()
    estimator.update(readings(30.0, 0.0), 0.0, 0.0)
    estimator.record_sent(Command())
    estimate = estimator.update(readings(None, 180.0, ReadingQuality.STALE), 180.0, 1180.0)
    expected = 30.0
    for _ in range(3):
        expected = 0.9 * expected + 0.1 * ROOM_C
    assert estimate.temp_air == pytest.approx(expected)
    history = estimator.history()
    assert history["time_s"].tolist() == [0.0, 60.0, 120.0, 180.0]
    assert history["utc"][1:].tolist() == [1060.0, 1120.0, 1180.0]
    assert history["heater_duty"][:3].tolist() == [0.0, 0.0, 0.0]


def test_after_a_long_sleep_the_filter_begins_anew():
    estimator = make()
    estimator.update(readings(30.0, 0.0), 0.0, 0.0)
    later = 60.0 * (HISTORY_ROWS + 1)
    estimate = estimator.update(readings(22.0, later), later, later)
    assert (estimate.temp_air, estimate.innovation) == (22.0, None)
    assert len(estimator.history()["temp_air"]) == 1


def test_too_few_rows_for_the_model_is_persistence():
    estimator = make(THREE_LAGS)
    estimator.update(readings(25.0, 0.0), 0.0, 0.0)
    estimator.record_sent(Command(heater_duty=1.0))
    assert estimator.update(readings(None, 60.0), 60.0, 60.0).temp_air == 25.0
    estimator.record_sent(Command(heater_duty=1.0))
    assert estimator.update(readings(None, 120.0), 120.0, 120.0).temp_air == 25.0
    estimator.record_sent(Command(heater_duty=1.0))
    assert estimator.update(readings(None, 180.0), 180.0, 180.0).temp_air > 25.5  # three rows: the model


class BrokenPredictor:
    """A predictor that gives no number."""

    name, version, step_s, rows_needed = "broken", "0", 60.0, 1

    def rollout(self, history, controls, ahead):
        return np.full(controls.shape[:2], math.nan)


def test_a_model_that_gives_no_number_is_persistence():
    estimator = Estimator(SETTINGS, BrokenPredictor(), 60.0, ROOM_C)
    estimator.update(readings(25.0, 0.0), 0.0, 0.0)
    assert estimator.update(readings(None, 60.0), 60.0, 60.0).temp_air == 25.0


def test_a_model_is_swapped_without_a_bump():
    estimator = make()
    plant = ArxPlant(ONE_LAG, np.random.default_rng(6), disturbance=0.1)
    run(estimator, plant, 300)
    other = replace(THREE_LAGS, intercept=0.7)
    before = estimator.update(readings(None, 18000.0), 18000.0, 0.0)
    estimator.record_sent(Command(heater_duty=0.5))
    twin = make()
    twin.__dict__.update({name: value for name, value in estimator.__dict__.items() if name != "_rows"})
    twin._rows = {name: column.copy() for name, column in estimator._rows.items()}
    estimator.set_model(other)
    swapped = estimator.update(readings(None, 18060.0), 18060.0, 0.0)
    kept = twin.update(readings(None, 18060.0), 18060.0, 0.0)
    assert swapped.temp_air == pytest.approx(kept.temp_air)
    assert swapped.temp_air_sd > 0.5 * before.temp_air_sd


def test_after_a_swap_the_offset_is_learnt_for_the_new_model():
    estimator = make()
    plant = ArxPlant(ONE_LAG, np.random.default_rng(7))
    run(estimator, plant, 200)
    estimator.set_model(replace(ONE_LAG, intercept=0.4))
    for tick in range(200, 400):
        estimate = estimator.update(readings(plant.measure(), 60.0 * tick), 60.0 * tick, 0.0)
        estimator.record_sent(Command())
        plant.step(Command())
    assert estimate.offset == pytest.approx(-0.4, abs=0.12)


def test_the_history_is_what_controllers_are_promised():
    estimator = make()
    plant = ArxPlant(ONE_LAG, np.random.default_rng(8))
    run(estimator, plant, HISTORY_ROWS + 30, gaps=range(140, 150))
    estimator.update(readings(24.0, 9000.0, light=0.5), 9000.0, 77.0)
    history = estimator.history()
    assert {len(column) for column in history.values()} == {HISTORY_ROWS}
    assert {"utc", "temp_air_measured", "heater_duty", "fan_on", *SIGNALS} <= set(history)
    assert np.isfinite(history["temp_air"]).all()
    assert np.isnan(history["temp_air_measured"]).sum() == 10
    assert math.isnan(history["heater_duty"][-1]) and math.isnan(history["fan_on"][-1])
    assert np.isfinite(history["heater_duty"][:-1]).all()
    assert (history["utc"][-1], history["light"][-1]) == (77.0, 0.5)
    assert math.isnan(history["co2"][-1])


def test_the_history_is_a_copy():
    estimator = make()
    estimator.update(readings(25.0, 0.0), 0.0, 0.0)
    estimator.history()["temp_air"][0] = 99.0
    assert estimator.history()["temp_air"][0] == 25.0


def test_the_room_is_the_last_good_value_and_the_default_before_one():
    estimator = make()
    air = {"temp_air": Reading("temp_air", 25.0, 0.0, ReadingQuality.GOOD)}
    assert estimator.update(air, 0.0, 0.0).temp_ambient == ROOM_C
    good = {"temp_ambient": Reading("temp_ambient", 18.0, 60.0, ReadingQuality.GOOD)}
    assert estimator.update({**air, **good}, 60.0, 60.0).temp_ambient == 18.0
    bad = {"temp_ambient": Reading("temp_ambient", 55.0, 120.0, ReadingQuality.STALE)}
    assert estimator.update({**air, **bad}, 120.0, 120.0).temp_ambient == 18.0


def test_the_same_readings_give_the_same_estimates_bit_for_bit():
    first = run(make(THREE_LAGS), ArxPlant(THREE_LAGS, np.random.default_rng(9)), 50)
    second = run(make(THREE_LAGS), ArxPlant(THREE_LAGS, np.random.default_rng(9)), 50)
    assert first == second
