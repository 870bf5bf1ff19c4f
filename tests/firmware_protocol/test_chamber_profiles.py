"""The predefined input sequences on the default chamber: the paper's data, in numbers."""

import pytest

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.profiles.record import RecordedRow, paths, read, record, write

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs() -> list[list[dict[str, float]]]:
    parameters, effects = load()
    profiles = [read(path) for path in paths()]
    return [record(Chamber(parameters, effects, int(facts["seed"])), rows) for facts, rows in profiles]


def test_there_are_fifteen_sequences_of_about_212_minutes_at_60_seconds():
    minutes = []
    for path in paths():
        times = [row.time_s for row in read(path)[1]]
        assert times == list(range(0, times[-1] + 1, 60))
        minutes.append(times[-1] / 60)
    assert len(minutes) == 15
    assert sum(minutes) / 15 == pytest.approx(212.0)
    assert min(minutes) > 190 and max(minutes) < 235


def test_duties_are_twentieths_and_both_inputs_move():
    for path in paths():
        rows = read(path)[1]
        assert all(0.0 <= row.heater_duty <= 1.0 for row in rows)
        assert all(row.heater_duty * 20 == pytest.approx(round(row.heater_duty * 20)) for row in rows)
        assert len({row.heater_duty for row in rows}) > 3
        assert {row.fan_on for row in rows} == {0, 1}


def test_the_runs_span_the_papers_range(runs):
    shown = [row["temp_air_c"] for run in runs for row in run]
    assert min(shown) == pytest.approx(21.8, abs=0.4)
    assert max(shown) == pytest.approx(36.9, abs=0.4)


def test_at_least_six_whole_runs_stay_in_the_low_part_of_the_range(runs):
    assert sum(max(row["temp_air_c"] for row in run) <= 29.7 for run in runs) >= 6


def test_the_room_is_at_about_21_degrees(runs):
    room = [row["temp_ambient_c"] for run in runs for row in run]
    assert sum(room) / len(room) == pytest.approx(21.5, abs=0.5)
    assert max(room) - min(room) > 0.5  # it wanders


def test_a_profile_file_reads_back_as_written(tmp_path):
    rows = [RecordedRow(0, 0.35, 1, 0.5), RecordedRow(60, 0.0, 0)]
    write(tmp_path / "p.csv", {"seed": "4", "notes": "a: b"}, rows)
    assert read(tmp_path / "p.csv") == ({"seed": "4", "notes": "a: b"}, rows)
