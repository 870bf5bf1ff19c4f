"""Profiles of inputs and references."""

from pathlib import Path

import pytest

from edge.core.errors import DataError
from edge.formats.profile_file import Profile, read_profile


def read(tmp_path: Path, text: str) -> Profile:
    path = tmp_path / "profile.csv"
    path.write_text(text)
    return read_profile(path)


def test_a_row_holds_until_the_next(tmp_path: Path) -> None:
    profile = read(tmp_path, "time_s,heater_duty,fan_on\n0,0.5,0\n60,1,1\n120,0,0\n")
    assert not profile.is_reference
    assert profile.end_s == 120.0
    expected = {-1.0: 0.5, 0.0: 0.5, 59.9: 0.5, 60.0: 1.0, 119.9: 1.0, 120.0: 0.0, 1e9: 0.0}
    assert {time_s: profile.at(time_s)["heater_duty"] for time_s in expected} == expected
    assert profile.at(60.0) == {"heater_duty": 1.0, "fan_on": 1.0}


def test_a_reference_profile(tmp_path: Path) -> None:
    profile = read(tmp_path, "time_s,reference_c\n0,24\n3600,28.5\n")
    assert profile.is_reference
    assert profile.at(3600.0) == {"reference_c": 28.5}


def test_light_may_be_given(tmp_path: Path) -> None:
    assert read(tmp_path, "time_s,light,heater_duty,fan_on\n0,0.3,0,0\n").at(0.0)["light"] == 0.3


@pytest.mark.parametrize(
    ("text", "expected"), [("", 0.0), ("# record_from_s: 0\n", 0.0), ("# record_from_s: 60\n", 60.0)]
)
def test_a_profile_may_begin_with_a_lead_in(tmp_path: Path, text: str, expected: float) -> None:
    assert read(tmp_path, text + "time_s,reference_c\n0,20\n61,21\n").record_from_s == expected


@pytest.mark.parametrize("text", ["61", "62", "-1", "nan", "inf", "soon", ""])
def test_a_lead_in_that_is_no_time_before_the_end_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(
        DataError, match=r"profile\.csv: record_from_s: .* is no time before the profile's end"
    ):
        read(tmp_path, f"# record_from_s: {text}\ntime_s,reference_c\n0,20\n61,21\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,heater_duty\n0,0\n", "a profile has time_s and either"),
        ("time_s,fan_on\n0,0\n", "a profile has time_s and either"),
        ("time_s\n0\n", "a profile has time_s and either"),
        ("time_s,heater_duty,fan_on,reference_c\n0,0,0,20\n", "a profile has time_s and either"),
        ("time_s,heater_duty,fan_on,valve\n0,0,0,0\n", "a profile has time_s and either"),
        ("time_s,heater_duty,fan_on\n0,1.05,0\n", "line 2: heater_duty: 1.05 is not in 0..1"),
        ("time_s,heater_duty,fan_on\n0,,0\n", "line 2: heater_duty: empty is not in 0..1"),
        ("time_s,heater_duty,fan_on\n0,0,0\n5,0,0.5\n", "line 3: fan_on: 0.5 is neither 0 nor 1"),
        ("time_s,reference_c\n0,\n", "line 2: reference_c: empty"),
        ("time_s,reference_c\n0,180\n", "line 2: reference_c: 180 is not in -20..80"),
        ("time_s,reference_c\n0,20\n0,21\n", "line 3: time_s: 0 does not come after"),
        ("time_s,reference_c\n", "there are no rows"),
    ],
)
def test_a_wrong_profile_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError) as error:
        read(tmp_path, text)
    assert message in str(error.value)
