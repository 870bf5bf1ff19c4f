"""`greenhouse twin new`: a twin file from what can be measured by hand."""

from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from edge.core.errors import DataError, RequestError
from edge.twin.box_words import quantity, volume, wall
from edge.twin.new_file import with_room_error
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import at_rest

KNOWN = ("--heater-w", "42", "--fan", "none")


def test_the_file_says_what_is_known_and_what_is_to_be_fitted(tmp_path: Path) -> None:
    place = tmp_path / "twin.yaml"
    words = ["twin", "new", str(place), "--edges", "50x50x60cm", "--heater-w", "100", "--fan", "exhaust"]
    assert main([*words, "--fan-flow", "68", "--wall", "polycarbonate:8mm", "--wall-area", "1.7"]) == 0
    file = read_twin_file(place)
    assert file.geometry["volume_m3"].value == pytest.approx(0.15)
    assert file.geometry["fan_max_m3_s"].value == pytest.approx(68.0 / 3600.0, rel=1e-4)
    # 1.7 m2 / (0.26 + 0.008 / 0.20) m2 K/W
    assert file.effects["wall_loss"]["UA"].value == pytest.approx(5.67, abs=0.01)
    assert file.effects["wall_loss"]["UA"].rel_sd == 0.3
    assert file.effects["extra_capacity"]["kC"].fit


def test_a_fan_that_stirs_changes_no_air(tmp_path: Path) -> None:
    place = tmp_path / "twin.yaml"
    assert main(["twin", "new", str(place), "--volume", "27l", "--heater-w", "42", "--fan", "stirring"]) == 0
    file = read_twin_file(place)
    assert file.fan_role == "stirring"
    assert file.effects["stirred_loss"]["G_stir"].fit
    assert file.twin().geometry.fan_max_m3_s < 1e-9
    assert file.geometry["fan_max_m3_s"].value > 1e-3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--volume", "120m3", *KNOWN), "120 m3 is a house: litres? (120l)"),
        (("--volume", "0.01l", *KNOWN), "is less than 0.1 litres"),
        (("--volume", "27l", "--heater-w", "42000", "--fan", "none"), "is not within 0.1..20000 W: kW?"),
        (("--volume", "27l", "--heater-w", "42", "--fan", "exhaust"), "--fan exhaust: needs --fan-flow"),
        (
            ("--volume", "27l", "--heater-w", "42", "--fan", "exhaust", "--fan-flow", "900"),
            "times an hour: l/min?",
        ),
        (("--volume", "27l", *KNOWN, "--wall-area", "0.5"), "--wall and --wall-area go together"),
    ],
)
def test_numbers_in_another_unit_are_asked_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert main(["twin", "new", str(tmp_path / "twin.yaml"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "twin.yaml").exists()


def test_a_file_that_is_there_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "twin.yaml"
    place.write_text("mine")
    assert main(["twin", "new", str(place), "--volume", "27l", *KNOWN]) == 2
    assert "is there already" in capsys.readouterr().err
    assert place.read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "volume_m3"),
    [("27l", 0.027), ("150 L", 0.15), ("0.15 m³", 0.15), ("150 litres", 0.15), ("50x50 x 60 cm", 0.15)],
)
def test_a_volume_is_read_as_people_write_it(words: str, volume_m3: float) -> None:
    assert volume(words) == pytest.approx(volume_m3)


@pytest.mark.parametrize("words", ["", "l", "0.15", "-5 l", "1e3 l", "nanl", "1,5l", "5 gal", "5x5 cm", "x"])
def test_a_volume_without_sense_or_unit_is_refused(words: str) -> None:
    with pytest.raises(RequestError):
        volume(words)


@pytest.mark.parametrize("words", ["plywood", "plywood:", "plywood:12", "air:1mm", ":"])
def test_a_wall_needs_a_known_material_and_a_thickness(words: str) -> None:
    with pytest.raises(RequestError):
        wall(words)


def test_a_number_may_stand_without_the_unit_that_was_asked_for() -> None:
    assert quantity("100", {"W": 1.0, "kW": 1000.0}, "W") == 100.0
    assert quantity("0.1 kw", {"W": 1.0, "kW": 1000.0}, "W") == pytest.approx(100.0)


def test_a_rig_without_a_room_sensor_has_a_twin_that_knows_how_wrong_its_room_is():
    file = read_twin_file(Path("training/results/paper_case/interpolation/twin.yaml"))
    changed = with_room_error(file, 21.0, 15.0)
    twin, steps = changed.twin(), 2000
    off = np.zeros((1, steps))
    given = {name: np.zeros(steps) for name in twin.needs}
    end_c = twin.rollout(at_rest(twin, 21.0, 21.0), off, off, 21.0, conditions=given)[0, -1]
    plain = file.twin().rollout(at_rest(file.twin(), 15.0, 15.0), off, off, 15.0, conditions=given)[0, -1]
    assert end_c == pytest.approx(plain, abs=0.05)
    with pytest.raises(DataError, match="b_amb"):
        with_room_error(file, 21.0, -3.0)
