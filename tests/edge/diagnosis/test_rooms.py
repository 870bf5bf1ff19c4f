"""Runs without a room sensor: what room is assumed; and fits whose twin runs away."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis import linearisation
from edge.diagnosis.fitting import fit
from edge.diagnosis.free_fit import fit_values, free_levels
from edge.diagnosis.nuisances import assumed_room, begins_at_rest
from edge.diagnosis.prepare import prepare, with_rooms
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import Trial
from edge.formats.run_file import RecordedRun
from edge.twin.run_batch import batch_runs
from edge.twin.value import Value
from tests.support.simulated_runs import BOX, as_diagnosis_runs, simulate, twin_file


@pytest.mark.parametrize(
    ("temps", "room_c", "rests"),
    [
        ([21.0, 22.0, 30.0, 40.0], 21.0, True),  # from a room
        ([23.0, 22.0, 21.5, 30.0], 23.0, True),  # soon after another run
        ([50.0, 45.0, 40.0, 60.0], 20.0, False),  # in the middle of something
        ([50.0, 55.0, 60.0, 65.0], 20.0, False),  # warmer than any room
        ([30.0, 20.0, 9.0, 12.0], 9.0, False),  # in a shed
        ([np.nan, 21.0, 30.0, 40.0], 21.0, True),
    ],
)
def test_a_run_that_begins_hot_is_in_no_hot_room(temps: list[float], room_c: float, rests: bool) -> None:
    assert assumed_room(np.array(temps)) == room_c
    assert begins_at_rest(np.array(temps)) == rests


def from_the_middle(run: RecordedRun) -> RecordedRun:
    """From where it is hottest of its first rows, of a room that nobody recorded."""
    begin = int(np.argmax(run.columns["temp_air_c"][:150]))
    columns = {key: values[begin:] for key, values in run.columns.items() if key != "temp_ambient_c"}
    columns["time_s"] = columns["time_s"] - columns["time_s"][0]
    return replace(run, columns=columns, facts={**run.facts, "temp_ambient_c": "none"})


def test_the_room_of_a_run_that_begins_hot_is_found() -> None:
    run = from_the_middle(simulate(BOX, 3, 400))
    assert not begins_at_rest(run.columns["temp_air_c"])
    file = replace(
        twin_file(),
        effects={"wall_loss": {"UA": Value(2.0, fit=True)}, "extra_capacity": {"kC": Value(20.0, fit=True)}},
    )
    known = prepare(file, as_diagnosis_runs([run], file=file))
    [found] = fit_values([known.file], known.terms, known.runs, 0.1, SideBySide())
    room_c = with_rooms(known, found.sizes).runs.ambient[0, 0]
    assert room_c == pytest.approx(21.0, abs=2.5)
    assert found.file.values()["effects", "wall_loss", "UA"].value == pytest.approx(4.0, rel=0.25)


def test_a_twin_that_runs_away_is_infinitely_bad_and_ends_no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = batch_runs([simulate(BOX, 1, 60)], 60.0)
    file = replace(
        twin_file(), effects={**twin_file().effects, "heater_lag": {"tau_h": Value(90.0, fit=True)}}
    )
    trial = Trial(file, free_levels(1.0))
    (sound,) = fit([trial], runs)
    real = linearisation.responses
    monkeypatch.setattr(linearisation, "responses", lambda wanted: 1e200 * real(wanted))
    (lost,) = fit([trial], runs)
    assert np.isfinite(sound.log_likelihood)
    assert lost.log_likelihood == -np.inf
    assert np.isfinite(lost.coordinates).all()
