"""The bounds of safety from a box's twin file."""

import json
from dataclasses import fields
from pathlib import Path

import pytest

from edge.app.box import bounds_of, box_bounds
from edge.core.errors import ConfigError
from edge.safety.box_bounds import PAPER_BOX, unknown_box
from edge.safety.thermal_supervision import Observation, ThermalMemory, look
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import read_twin_file

DIAGNOSED = Path("training/results/paper_case/interpolation/twin.yaml")


def test_without_a_file_it_is_the_papers_box():
    assert bounds_of("") is PAPER_BOX


def test_the_papers_box_fitted_has_about_the_bounds_that_stand_for_it():
    found = bounds_of(str(DIAGNOSED))
    for item in fields(PAPER_BOX):
        told, stands = getattr(found, item.name), getattr(PAPER_BOX, item.name)
        assert told == stands or 0.6 < told / stands < 1.8, item.name


def test_a_box_ten_times_as_large_has_ten_times_the_bounds(tmp_path):
    small, large = (described(tmp_path, size) for size in (1.0, 10.0))
    for name in ("capacity_max_j_k", "capacity_min_j_k", "loss_max_w_k", "loss_min_w_k", "power_max_w"):
        assert getattr(large, name) == pytest.approx(10.0 * getattr(small, name), rel=1e-6), name


def described(folder: Path, size: float):
    path = folder / f"{size:g}.yaml"
    path.write_text(
        f"geometry: {{volume_m3: {0.05 * size}, heater_max_w: {40.0 * size}, fan_max_m3_s: {0.004 * size}}}\n"
        f"effects: {{wall_loss: {{UA: {2.0 * size}}}, extra_capacity: {{kC: 12.0}}}}\n"
    )
    return bounds_of(str(path))


def test_a_box_that_is_not_fitted_yet_tells_its_heater_alone(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text(text(BoxDescription(0.4, 250.0, "none")))
    assert box_bounds(read_twin_file(path)) == unknown_box(250.0, "none")


@pytest.mark.parametrize(("duty", "fan", "air"), [(1.0, False, 21.0), (0.0, False, 60.0), (0.0, True, 60.0)])
def test_of_an_unknown_box_nothing_is_claimed(duty, fan, air):
    memory = ThermalMemory()
    for minute in range(600):
        moment = Observation(60.0, air + 0.02 * minute * (not duty), 20.0, duty, fan, 0.0)
        memory, found = look(memory, moment, unknown_box(250.0, "exhaust"))
        assert found == ()


def test_a_fan_that_only_stirs_is_never_called_blocked(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text(
        "geometry: {volume_m3: 0.05, heater_max_w: 40.0}\nfan_role: stirring\n"
        "effects: {wall_loss: {UA: 2.0}, extra_capacity: {kC: 12.0}}\n"
    )
    assert not bounds_of(str(path)).fan_cools


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"box.twin: .*missing.yaml"):
        bounds_of(str(tmp_path / "missing.yaml"))


def test_bounds_are_plain_numbers():
    found = bounds_of(str(DIAGNOSED))
    json.dumps({item.name: getattr(found, item.name) for item in fields(found)})
