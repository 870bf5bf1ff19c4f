"""A box of the fleet as if it were new: which hour it is learnt from, and what comes of it."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.runs import FROM_S
from edge.formats.run_file import RecordedRun
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from fleet.priors.rehearsal import an_hour, rehearse
from tests.support.simulated_runs import BOX, Effects, simulate, twin_file


def heated(minutes: int, *hot: tuple[int, int], step_s: float = 60.0) -> RecordedRun:
    """Return a run with full heat in these minutes."""
    time_s = step_s * np.arange(round(60.0 * minutes / step_s))
    duty = np.zeros(len(time_s))
    for begin, end in hot:
        duty[(time_s >= 60.0 * begin) & (time_s < 60.0 * end)] = 1.0
    columns = {"time_s": time_s, "temp_air_c": np.full(len(time_s), 20.0), "heater_duty": duty}
    return replace(simulate(BOX, 1, 1), columns=columns)


def judged(run: RecordedRun) -> int:
    """Return how many rows of a run are judged."""
    return int((run.columns["time_s"] >= float(run.facts.get(FROM_S, 0.0))).sum())


def test_the_hour_is_the_first_in_which_the_heater_changes_much() -> None:
    tests, day = heated(240, (20, 35), (180, 200)), heated(600, (30, 60), step_s=10.0)
    hour, rest = an_hour([tests, day])
    assert len(hour) == 60 and hour.columns["heater_duty"][20:35].all()
    assert [judged(run) for run in rest] == [180, 3600]
    hour, rest = an_hour([heated(240), day])
    assert len(hour) == 360 and [judged(run) for run in rest] == [240, 3240]
    hour, rest = an_hour([heated(240, (110, 150))])
    assert [judged(run) for run in (hour, *rest)] == [60, 60, 120]
    assert [len(run) for run in rest] == [60, 240]  # what follows knows what was before


def test_an_hour_that_was_not_measured_is_none() -> None:
    run = heated(300, (5, 20), (120, 140))
    run.columns["temp_air_c"][:90] = np.nan
    hour, rest = an_hour([run])
    assert np.isfinite(hour.columns["temp_air_c"]).sum() > 30 and len(hour) == 60
    assert hour.columns["heater_duty"].any() and [judged(run) for run in rest] == [170]


def test_no_row_is_judged_in_two_of_them() -> None:
    run = heated(300, (95, 140))
    hour, rest = an_hour([run])
    assert len(hour) + sum(map(judged, rest)) == len(run)


@pytest.mark.parametrize("runs", [[], [heated(240)], [heated(30, (5, 10))], [heated(60, (5, 10))]])
def test_without_an_hour_of_heat_or_anything_beside_it_nothing_is_rehearsed(runs: list[RecordedRun]) -> None:
    with pytest.raises(DataError):
        an_hour(runs)


def of_kind(losses_w_k: tuple[float, ...]) -> list[TwinFile]:
    """Return twins of boxes that differ in their loss."""
    values = [{**BOX, "wall_loss": {"UA": loss}} for loss in losses_w_k]
    return [replace(twin_file(own), provenance={"after": {"test": {"rmse_k": 0.3}}}) for own in values]


def recorded(hidden: Effects, minutes: int = 600) -> RecordedRun:
    return simulate({**BOX, **hidden}, 1, minutes)


def test_boxes_are_foretold_like_their_kind_or_odd_in_one_value() -> None:
    loss = BOX["wall_loss"]["UA"]
    others = of_kind((0.9 * loss, 1.1 * loss))
    for own in (loss, 0.4 * loss):
        assert rehearse(twin_file(), [recorded({"wall_loss": {"UA": own}})], others).missed_k < 0.5


def in_rows_of_10_s(run: RecordedRun) -> RecordedRun:
    """Return a run as step tests record it."""
    time_s = np.arange(0.0, run.columns["time_s"][-1], 10.0)
    rows = (time_s // 60.0).astype(int)
    columns = {name: column[rows] for name, column in run.columns.items()}
    columns["temp_air_c"] = np.interp(time_s, run.columns["time_s"], run.columns["temp_air_c"])
    return replace(run, columns=columns | {"time_s": time_s})


def test_what_an_hour_stored_in_a_slow_body_is_known_after_it() -> None:
    hidden = {"slow_mass": {"C_m": 300_000.0, "G_m": 4.0}}
    others = [
        replace(own, effects={**own.effects, **twin_file(hidden).effects}) for own in of_kind((4.0, 4.0))
    ]
    assert rehearse(twin_file(), [in_rows_of_10_s(recorded(hidden, 300))], others).missed_k < 0.15


def test_recordings_count_alike_however_long_they_are() -> None:
    loss = BOX["wall_loss"]["UA"]
    tests, day = recorded({}, 300), recorded({"constant_heat": {"P0": 10.0}}, 600)
    others = of_kind((0.95 * loss, 1.05 * loss))
    short, both = (rehearse(twin_file(), runs, others).missed_k for runs in ([tests], [tests, day]))
    alone = 10.0 / loss  # how far the day is off, by a heat that is not the box's
    assert both == pytest.approx(np.sqrt(short * alone), rel=0.3)


def test_what_the_box_told_of_itself_is_not_known() -> None:
    loss = BOX["wall_loss"]["UA"]
    others = of_kind((0.9 * loss, 1.1 * loss))
    told = replace(twin_file(), effects={**twin_file().effects, "wall_loss": {"UA": Value(9.0 * loss)}})
    run = recorded({})
    assert rehearse(told, [run], others) == rehearse(twin_file(), [run], others)


def test_a_day_counts_by_the_rows_that_it_has() -> None:
    hidden = {"extra_capacity": {"kC": 1.0}}
    others = [
        replace(own, effects={**own.effects, **twin_file(hidden).effects}) for own in of_kind((4.0, 4.0))
    ]
    # Between its rows, of a minute, the air of a fast box is far from a straight line: 0.24 K if it counted.
    tests, day = in_rows_of_10_s(recorded(hidden, 90)), recorded(hidden, 600)
    assert rehearse(twin_file(), [tests, day], others).missed_k < 0.2


def test_heat_that_comes_by_day_is_told_as_less_loss() -> None:
    loss = BOX["wall_loss"]["UA"]
    others = of_kind((loss, loss))
    hour, plain = recorded({}, 90), recorded({}, 900)
    warm = recorded({"constant_heat": {"P0": 10.0}}, 900)
    assert rehearse(twin_file(), [hour, plain], others).loss_share == pytest.approx(1.0, abs=0.03)
    share = rehearse(twin_file(), [hour, warm], others).loss_share
    above_k = float(np.mean(warm.columns["temp_air_c"] - warm.columns["temp_ambient_c"]))
    assert share == pytest.approx(1.0 - 10.0 / (loss * above_k), abs=0.08)
    for run in (hour, warm):
        del run.columns["temp_ambient_c"]
    assert rehearse(twin_file(), [hour, warm], others).loss_share == 1.0
