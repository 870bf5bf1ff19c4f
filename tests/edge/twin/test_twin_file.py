import re
from pathlib import Path

import pytest

from edge.core.errors import DataError
from edge.twin import schema
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin, StateNoise
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value

EXAMPLE = """\
geometry: {volume_m3: 0.15, heater_max_w: {fit: true, start: 90}, air_density_kg_m3: 1.2}
sample_s: 30
effects:
  wall_loss: {UA: {value: 5.1, low: 4.8, high: 5.4}}
  fan_effectiveness: {eps_f: {value: 0.68, rel_sd: 0.05}}
  heater_lag: {tau_h: {fit: true, start: 240}}
  extra_capacity: {kC: {fit: true}}
  heater_efficiency: {eta: 1}
sensor: {quantisation_k: 0.1, noise_sd_k: null}
nuisance: {heater_power_run_sd: 0.015, heat_noise_sd_w: 2.5}
provenance: {data_sha256: abc, before: {rmse_k: 0.7}, software: greenhouse-twin 0.1.0}
"""
LOSS = "effects: {wall_loss: {UA: %s}}"

REFUSED = [
    ("geometri: {}", "unknown key 'geometri'; did you mean 'geometry'?"),
    ("geometry: {volume: 1}", "geometry: unknown key 'volume'; did you mean 'volume_m3'?"),
    ("geometry: 0.15", "geometry: must hold keys and values, not 0.15"),
    ("geometry: {volume_m3: 0}", "geometry.volume_m3: 0 is not a finite number above 0"),
    ("geometry: {volume_m3: big}", "geometry.volume_m3: must be a number, not 'big'"),
    ("fan_role: exhaus", "fan_role: 'exhaus' is none of exhaust, stirring, none"),
    ("fan_control: percent", "fan_control: 'percent' is none of relay, speed"),
    ("day0_utc: today", "day0_utc: 'today' is no time like 2026-07-01T12:00:00Z"),
    ("day0_utc: 5", "day0_utc: must be text, not 5"),
    ("sample_s: 0", "sample_s: 0 is not a finite number above 0"),
    ("effects: {wall_lost: {UA: 5}}", "effects: unknown effect 'wall_lost'; did you mean 'wall_loss'?"),
    ("effects: {1: {UA: 5}}", "effects.1: must be text, not 1"),
    ("effects: {heater_lag: {tau: 5}}", "effects.heater_lag: unknown parameter 'tau'; did you mean 'tau_h'?"),
    ("effects: {wall_loss: 5.1}", "effects.wall_loss: must hold keys and values, not 5.1"),
    ("effects: {wall_loss: }", "effects.wall_loss.UA: missing"),
    (LOSS % "-1", "effects.wall_loss.UA: -1 is outside 0..1e+06 W/K"),
    (LOSS % ".inf", "effects.wall_loss.UA: inf is not a finite number"),
    (LOSS % "null", "effects.wall_loss.UA: must be a number, not None"),
    (LOSS % "{value: 5, relsd: 0.1}", "effects.wall_loss.UA: unknown key 'relsd'; did you mean 'rel_sd'?"),
    (LOSS % "{rel_sd: 0.1}", "effects.wall_loss.UA.value: missing"),
    (LOSS % "{value: 5, rel_sd: 0}", "effects.wall_loss.UA.rel_sd: 0 is not above 0"),
    (LOSS % "{value: 5, low: null, high: null}", "effects.wall_loss.UA.low: must be a number, not None"),
    (LOSS % "{value: 5, low: 4}", "effects.wall_loss.UA: low and high go together"),
    (LOSS % "{value: 5, low: 6, high: 7}", "effects.wall_loss.UA: 5 is outside 6..7"),
    (LOSS % "{value: 5, start: 4}", "effects.wall_loss.UA: unknown key 'start'"),
    (LOSS % "{fit: false, start: 5}", "effects.wall_loss.UA.fit: False is not True"),
    (LOSS % "{fit: true, value: 5}", "effects.wall_loss.UA: unknown key 'value'"),
    (LOSS % "{fit: true, start: 2e6}", "effects.wall_loss.UA: 2e+06 is outside 0..1e+06 W/K"),
    ("sensor: {noise_k: 0.1}", "sensor: unknown key 'noise_k'; did you mean 'noise_sd_k'?"),
    ("sensor: {noise_sd_k: -0.1}", "sensor.noise_sd_k: -0.1 is below the smallest allowed, 0"),
    ("sensor: {noise_sd_k: {value: 0.1}}", "sensor.noise_sd_k: must be a number, not {'value': 0.1}"),
    ("sample_s: 60\nsample_s: 30", "not YAML: "),
]


def read(folder: Path, text: str) -> TwinFile:
    path = folder / "twin.yaml"
    path.write_text(text, encoding="utf-8")
    return read_twin_file(path)


def test_every_way_to_know_a_value_is_read(tmp_path):
    file = read(tmp_path, EXAMPLE)
    assert file.effects["wall_loss"]["UA"] == Value(5.1, low=4.8, high=5.4)
    assert file.effects["fan_effectiveness"]["eps_f"] == Value(0.68, rel_sd=0.05)
    assert file.effects["heater_lag"]["tau_h"] == Value(240.0, fit=True)
    assert file.effects["extra_capacity"]["kC"] == Value(5.0, fit=True)  # the table's start
    assert file.effects["heater_efficiency"]["eta"] == Value(1.0)
    assert file.to_fit() == [
        ("geometry", "heater_max_w"),
        ("effects", "heater_lag", "tau_h"),
        ("effects", "extra_capacity", "kC"),
    ]


def test_the_twin_has_the_values_of_its_file(tmp_path):
    twin = read(tmp_path, EXAMPLE).twin()
    assert twin.geometry == Geometry(heater_max_w=90.0)  # what the file leaves out is the paper's
    assert (twin.effects["wall_loss"], twin.effects["heater_lag"]) == ({"UA": 5.1}, {"tau_h": 240.0})
    assert (twin.step_s, twin.noise) == (30.0, StateNoise(sensor_k=0.1, heat_w=2.5, step_k=0.1))


def test_an_empty_file_is_the_papers_model(tmp_path):
    file = read(tmp_path, "")
    assert file == TwinFile()
    assert file.twin().sha256 == BoxTwin().sha256


def test_what_is_written_reads_back_the_same(tmp_path):
    file, path = read(tmp_path, EXAMPLE), tmp_path / "again.yaml"
    write_twin_file(file, path)
    assert read_twin_file(path) == file
    assert "wall_loss:\n    UA: {value: 5.1, low: 4.8, high: 5.4}" in path.read_text()


def test_a_day_is_read_and_written_as_a_time(tmp_path):
    file, path = read(tmp_path, "day0_utc: 2026-07-01T02:00:00+02:00"), tmp_path / "again.yaml"
    assert file.twin().day0_utc == 1782864000.0  # date -u -d 2026-07-01 +%s
    write_twin_file(file, path)
    assert "day0_utc: '2026-07-01T00:00:00+00:00'" in path.read_text()
    assert read_twin_file(path) == file
    assert file.twin().sha256 != BoxTwin().sha256


def test_the_fact_that_the_fan_has_a_speed_reaches_the_twin_and_the_next_file(tmp_path):
    file, path = read(tmp_path, "fan_control: speed"), tmp_path / "again.yaml"
    assert file.twin().sha256 == BoxTwin(fan_control="speed").sha256
    write_twin_file(file.with_values({("geometry", "heater_max_w"): Value(90.0)}), path)
    assert read_twin_file(path).fan_control == "speed"


@pytest.mark.parametrize("number", [0.1 + 0.2, 1e-4, 1.2345678901234567e-5, 99.99999999999999])
def test_a_number_is_written_to_its_last_digit(tmp_path, number):
    path = tmp_path / "twin.yaml"
    write_twin_file(TwinFile(effects={"wall_loss": {"UA": Value(number)}}), path)
    assert read_twin_file(path).effects["wall_loss"]["UA"].value == number


def test_changed_values_leave_the_others(tmp_path):
    file = read(tmp_path, EXAMPLE)
    changed = file.with_values({("effects", "heater_lag", "tau_h"): Value(300.0, low=280.0, high=320.0)})
    assert changed.effects["heater_lag"]["tau_h"].value == 300.0
    assert changed.effects["wall_loss"] == file.effects["wall_loss"]
    assert changed.geometry == file.geometry


@pytest.mark.parametrize(("text", "message"), REFUSED, ids=[text for text, _ in REFUSED])
def test_what_is_wrong_is_refused_with_file_and_place(tmp_path, text, message):
    path = tmp_path / "twin.yaml"
    with pytest.raises(DataError, match="^" + re.escape(f"{path}: {message}")):
        read(tmp_path, text)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(DataError, match=re.escape(f"{tmp_path / 'none.yaml'}: cannot be read")):
        read_twin_file(tmp_path / "none.yaml")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=re.escape(f"{path}: cannot be read")):
        read_twin_file(path)


def test_the_schema_file_is_the_one_the_code_writes():
    kept = Path(schema.__file__).with_name("twin.schema.json").read_text(encoding="utf-8")
    assert kept == schema.document(), "run: python -m edge.twin.schema > edge/twin/twin.schema.json"
