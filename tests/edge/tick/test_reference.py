"""edge/tick/reference.py: targets over time, at the edges of their breakpoints."""

from datetime import UTC, datetime, time
from pathlib import Path

import numpy as np
import pytest

from edge.config.settings import DailyReference, RampReference, ReferenceSettings, ReferenceStep
from edge.core.errors import DataError
from edge.tick.reference import Reference, make_reference, reference_from_profile, seconds_of_day, zone_of

MIDNIGHT = datetime(2026, 3, 1, tzinfo=UTC).timestamp()


def ahead(settings: ReferenceSettings, since_start_s: float, steps: int = 3, at: float = 0.0) -> list[float]:
    reference = make_reference(settings)
    return [float(v) for v in reference.ahead(since_start_s, at, 60.0, steps)]


def test_a_constant_is_the_same_at_any_time() -> None:
    assert ahead(ReferenceSettings(reference_c=25.0), 1e6) == [25.0, 25.0, 25.0]


def test_a_step_holds_from_its_time_on() -> None:
    steps = (ReferenceStep(at_s=0.0, reference_c=22.0), ReferenceStep(at_s=120.0, reference_c=28.0))
    settings = ReferenceSettings(kind="steps", steps=steps)
    assert ahead(settings, 0.0) == [22.0, 22.0, 28.0]
    assert ahead(settings, 119.0, 1) == [22.0]
    assert ahead(settings, 120.0, 1) == [28.0]


def test_before_the_first_step_its_value_is_taken_early() -> None:
    settings = ReferenceSettings(kind="steps", steps=(ReferenceStep(at_s=600.0, reference_c=27.0),))
    assert ahead(settings, 0.0, 1) == [27.0]


def test_a_daily_schedule_holds_its_last_value_over_midnight() -> None:
    daily = (DailyReference(at=time(6), reference_c=26.0), DailyReference(at=time(22), reference_c=20.0))
    settings = ReferenceSettings(kind="daily", daily=daily)
    assert ahead(settings, 0.0, 1, at=5 * 3600.0) == [20.0]
    assert ahead(settings, 0.0, 1, at=6 * 3600.0) == [26.0]
    assert ahead(settings, 0.0, 2, at=22 * 3600.0 - 60.0) == [26.0, 20.0]
    assert ahead(settings, 0.0, 3, at=86400.0 - 60.0) == [20.0, 20.0, 20.0]


def test_a_ramp_is_a_line_between_two_flats() -> None:
    settings = ReferenceSettings(
        kind="ramp", ramp=RampReference(from_c=20.0, to_c=26.0, start_s=60.0, duration_s=120.0)
    )
    assert ahead(settings, 0.0, 5) == [20.0, 20.0, 23.0, 26.0, 26.0]


def test_a_profile_file_is_a_reference(tmp_path: Path) -> None:
    path = tmp_path / "reference.csv"
    path.write_text("time_s,reference_c\n0,22\n300,30\n")
    reference = reference_from_profile(path)
    assert list(reference.ahead(240.0, 0.0, 60.0, 2)) == [22.0, 30.0]


def test_a_profile_without_a_reference_names_file_and_column(tmp_path: Path) -> None:
    path = tmp_path / "inputs.csv"
    path.write_text("time_s,heater_duty,fan_on\n0,0.5,0\n")
    with pytest.raises(DataError, match=r"inputs\.csv.*reference_c"):
        reference_from_profile(path)


def test_local_time_of_day_follows_the_zone() -> None:
    summer = datetime(2026, 7, 1, 12, 0, tzinfo=UTC).timestamp()
    assert seconds_of_day(summer, zone_of("Europe/Oslo")) == 14 * 3600.0
    assert seconds_of_day(summer, zone_of("UTC")) == 12 * 3600.0


def test_targets_come_in_the_shape_of_their_times() -> None:
    reference = Reference(np.array([0.0, 10.0]), np.array([1.0, 2.0]))
    times = np.array([[0.0, 9.9], [10.0, 99.0]])
    assert reference.at(times, times).tolist() == [[1.0, 1.0], [2.0, 2.0]]
