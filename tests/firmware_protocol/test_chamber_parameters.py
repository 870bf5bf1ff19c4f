"""chamber.yaml: sources, changes, refusals."""

import dataclasses

import pytest
import yaml

from firmware_protocol.virtual_board.chamber_parameters import DEFAULT_FILE, load
from firmware_protocol.virtual_board.effects import Effects


def test_every_parameter_has_a_number_and_a_source():
    for section in yaml.safe_load(DEFAULT_FILE.read_text(encoding="utf-8")).values():
        for entry in section.values():
            assert set(entry) == {"value", "source"}
            assert isinstance(entry["value"], float)
            assert entry["source"]


def test_the_default_box_is_the_papers():
    parameters, effects = load()
    assert parameters.box.volume_m3 == pytest.approx(0.15)
    assert parameters.box.cover_m2 == pytest.approx(1.45)  # 4 * 0.5 * 0.6 + 0.5 * 0.5
    assert parameters.heater.power_w == 100.0
    assert parameters.fan.flow_m3_s * 3600.0 == pytest.approx(68.0, rel=1e-4)
    assert effects == Effects()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path):
    path = tmp_path / "box.yaml"
    path.write_text("room: {temp_c: 26, diurnal_k: {value: 1.5, source: summer}}\neffects: {sun_window: 1}\n")
    parameters, effects = load(path)
    default, default_effects = load()
    assert (parameters.room.temp_c, parameters.room.diurnal_k) == (26.0, 1.5)
    room = dataclasses.replace(parameters.room, temp_c=default.room.temp_c, diurnal_k=default.room.diurnal_k)
    assert dataclasses.replace(parameters, room=room) == default
    assert effects == dataclasses.replace(default_effects, sun_window=1.0)


def test_an_empty_file_is_the_default(tmp_path):
    (tmp_path / "box.yaml").write_text("")
    assert load(tmp_path / "box.yaml") == load()


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("rooom: {temp_c: 20}", r"box\.yaml: unknown key 'rooom'"),
        ("room: {temp: 20}", r"box\.yaml\.room: unknown key 'temp'"),
        ("effects: {wall_los: 1}", r"box\.yaml\.effects: unknown effect 'wall_los'"),
        ("effects: {wall_loss: -1}", r"effects\.wall_loss: -1 is outside 0\.\.4"),
        ("room: {temp_c: warm}", r"box\.yaml\.room\.temp_c: 'warm' is not a finite number"),
        ("room: {temp_c: .nan}", r"box\.yaml\.room\.temp_c: nan is not a finite number"),
        ("room: {temp_c: true}", r"box\.yaml\.room\.temp_c: True is not a finite number"),
        ("room: {temp_c: null}", r"box\.yaml\.room\.temp_c: None is not a finite number"),
        ("heater: {power_w: -1}", r"box\.yaml\.heater\.power_w: -1 is outside 0"),
        ("cover: {gap_w_m2_k: 0}", r"box\.yaml\.cover\.gap_w_m2_k: 0 is outside"),
        ("heater: {efficiency: 1.01}", r"box\.yaml\.heater\.efficiency: 1\.01 is outside 0\.\.1"),
        ("box: {heater_zone_share: 1}", r"box\.yaml\.box\.heater_zone_share: 1 is outside 0\.05\.\.0\.95"),
        ("room: 3", r"box\.yaml: not a mapping of sections"),
        ("[" * 5000, r"box\.yaml: maximum recursion depth"),
        ("room: {", r"box\.yaml: while parsing"),
        ("- room", r"box\.yaml: not a mapping of sections"),
        ("room: {temp_c: {value: 20}}\nroom2: {}", r"unknown key 'room2'"),
    ],
)
def test_a_wrong_file_is_refused_and_the_place_named(tmp_path, text, place):
    path = tmp_path / "box.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=place):
        load(path)
