"""Logs as people have them, made by equations apart from the twin's: what is said first has to be right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.diagnosis.gap import forecasts
from edge.diagnosis.prepare import prepare
from edge.diagnosis.readings import stuck_readings
from edge.diagnosis.runs import diagnosis_runs
from edge.formats.run_file import RecordedRun
from edge.twin.run_batch import batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import candidates_only, silent

Floats = NDArray[np.float64]
NOISE_K = 0.05
OFF_S = 300  # that a log begins without heat


def box(litres: float, heater_w: float, step_s: float) -> TwinFile:
    """As `greenhouse twin new` writes it: loss and capacity are to be found."""
    fit = Value(1.0, fit=True)
    plain = TwinFile()
    return replace(
        plain,
        geometry={**plain.geometry, "volume_m3": Value(litres / 1e3), "heater_max_w": Value(heater_w)},
        sample_s=step_s,
        effects={"wall_loss": {"UA": fit}, "extra_capacity": {"kC": replace(fit, value=5.0)}},
        fan_role="none",
    )


class LoggedBox:
    """Air, element and contents by Euler's steps of a second [J/K, W/K, W], a thermostat or a slow PI."""

    def __init__(
        self, seed: int, air: float, loss: float, body: tuple[float, float], lag_s: float, heater_w: float
    ):
        self.draw = np.random.default_rng(seed)
        self.air, self.loss, self.body, self.lag_s, self.heater_w = air, loss, body, lag_s, heater_w

    def log(
        self, hours: float, every_s: int, band_k: float, lid: tuple[int, ...] = (), lid_w_k: float = 8.0
    ) -> RecordedRun:
        """lid : when it is opened for 40 s [s]"""
        count = round(hours * 3600.0)
        room = 20.0 + 0.7 * np.sin(np.arange(count) / 5000.0 + self.draw.uniform(0.0, 6.0))
        air = contents = float(room[0])
        heat_w = duty = 0.0
        rows = []
        for k in range(count):
            if k % every_s == 0:
                shown = air + NOISE_K * self.draw.standard_normal()
                wanted = 0.0 if k < OFF_S else 30.0 if k < 0.6 * count else 27.0
                duty = 1.0 if shown < wanted - band_k else 0.0 if shown > wanted + band_k else duty
                rows.append((float(k), shown, room[k], duty))
            opened = any(begin <= k < begin + 40 for begin in lid)
            to_body = self.body[1] * (air - contents)
            lost = (self.loss + lid_w_k * opened) * (air - room[k])
            heat_w += (self.heater_w * duty - heat_w) / self.lag_s
            air += (heat_w - lost - to_body) / self.air
            contents += to_body / self.body[0]
        names = ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty")
        return RecordedRun(dict(zip(names, np.array(rows).T, strict=True)), {}, Path("log.csv"))


def found_in(file: TwinFile, *runs: RecordedRun) -> Diagnosis:
    named = [(f"run_{i}.csv", run) for i, run in enumerate(runs, 1)]
    names = ("heater_lag", "soil_mass", "sensor_lag", "heater_saturation", "constant_heat", "door_opening")
    with candidates_only(*names):
        return diagnose(file, diagnosis_runs(named, [], file), silent, "x")


def test_a_thermostat_log_names_contents_and_element() -> None:
    rig = LoggedBox(1, air=900.0, loss=1.1, body=(16_000.0, 3.0), lag_s=90.0, heater_w=60.0)
    found = found_in(box(150.0, 60.0, 60.0), rig.log(10.0, 30, band_k=0.6))
    assert {item.name for item in found.verdict.effects} <= {"soil_mass", "heater_lag", "sensor_lag"}
    assert found.verdict.effects[0].name == "soil_mass"
    assert found.verdict.effects[0].parameters["C_s"].value == pytest.approx(16_000.0, rel=0.1)
    assert found.after.fit.rmse_k < 2.0 * NOISE_K


def test_a_lid_that_is_opened_hides_neither_the_heaters_lag_nor_itself() -> None:
    rig = LoggedBox(2, air=100.0, loss=0.9, body=(2500.0, 1.2), lag_s=100.0, heater_w=40.0)
    lids = (3000, 7100), (2500, 8500)
    runs = [rig.log(2.6, 10, band_k=0.4, lid=own) for own in lids]
    found = found_in(box(20.0, 40.0, 10.0), *runs)
    assert [(door.run, round(door.from_s, -2)) for door in found.doors] == [
        (f"run_{i}.csv", pytest.approx(at, abs=100.0)) for i, own in enumerate(lids, 1) for at in own
    ]
    names = {item.name for item in found.verdict.effects}
    assert "soil_mass" in names and names & {"heater_lag", "sensor_lag"}
    assert "door_opening" not in names  # an event, and no fault of the twin
    assert found.after.fit.rmse_k < 0.4 * found.before.fit.rmse_k


def test_what_a_poor_twin_misses_is_not_called_noise() -> None:
    rig = LoggedBox(3, air=900.0, loss=1.1, body=(16_000.0, 3.0), lag_s=90.0, heater_w=60.0)
    file = box(150.0, 60.0, 60.0)
    with candidates_only():
        found = diagnose(file, diagnosis_runs([("a", rig.log(4.0, 30, 0.6))], [], file), silent, "x")
    assert found.before.fit.rmse_k > 10.0 * found.inputs.noise_k
    assert found.inputs.noise_k < 2.0 * NOISE_K


def test_a_resting_test_runs_room_is_its_first_reading_however_warm_the_training_was() -> None:
    rig = LoggedBox(4, air=900.0, loss=1.1, body=(16_000.0, 3.0), lag_s=1.0, heater_w=60.0)
    first = rig.log(2.0, 60, 0.6)
    columns = {name: values for name, values in first.columns.items() if name != "temp_ambient_c"}
    train = replace(first, columns=columns)
    colder = {**columns, "temp_air_c": columns["temp_air_c"] - 6.0}
    file = box(150.0, 60.0, 60.0)
    data = diagnosis_runs([("a", train)], [("b", replace(first, columns=colder))], file)
    known = prepare(file, data)
    with candidates_only():
        fit = diagnose(file, data, silent, "x").before.fit
    (shown,) = forecasts(fit, data.test, known)
    assert shown.room_c == pytest.approx(colder["temp_air_c"][:3].mean(), abs=0.2)


def test_a_plateau_of_a_coarse_sensor_is_a_reading() -> None:
    rig = LoggedBox(5, air=900.0, loss=1.1, body=(16_000.0, 3.0), lag_s=90.0, heater_w=60.0)
    run = rig.log(4.0, 30, band_k=1.5)
    coarse = {**run.columns, "temp_air_c": 0.32 * np.round(run.columns["temp_air_c"] / 0.32)}
    assert not stuck_readings(batch_runs([replace(run, columns=coarse)], 30.0)).any()


def test_a_heater_that_never_ran_names_nothing_of_the_heater() -> None:
    rig = LoggedBox(6, air=900.0, loss=1.1, body=(16_000.0, 3.0), lag_s=90.0, heater_w=60.0)
    run = rig.log(3.0, 60, band_k=100.0)
    warm = {**run.columns, "temp_air_c": run.columns["temp_air_c"] + 8.0 * np.exp(-np.arange(180) / 60.0)}
    file = box(150.0, 60.0, 60.0)
    found = diagnose(file, diagnosis_runs([("a", replace(run, columns=warm))], [], file), silent, "x")
    assert not {item.name for item in found.verdict.effects} & {
        "heater_lag",
        "imperfect_mixing",
        "heater_sag",
    }
