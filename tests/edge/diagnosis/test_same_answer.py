"""Invariance of a diagnosis: a few bad readings, the order of the runs, the start of a fit."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.formats.run_file import RecordedRun, cut
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import (
    BOX,
    as_diagnosis_runs,
    candidates_only,
    change_run,
    silent,
    simulate,
    twin_file,
)

pytestmark = pytest.mark.slow

HIDDEN = {"heater_lag": {"tau_h": 300.0}}
CANDIDATES = ("infiltration", "heater_lag", "heater_deadtime", "heater_efficiency", "sensor_lag")
ROWS, BAD = 80, 10
Change = Callable[[Sequence[RecordedRun]], Sequence[RecordedRun]]


@pytest.fixture(autouse=True, scope="module")
def _few_candidates() -> Iterator[None]:
    """What is asked here does not depend on how many effects there are; time goes with them."""
    with candidates_only(*CANDIDATES):
        yield


def recordings() -> list[RecordedRun]:
    return [simulate({**BOX, **HIDDEN}, seed, ROWS) for seed in (1, 2, 3)]


def answer(runs: Sequence[RecordedRun], file: TwinFile | None = None) -> Diagnosis:
    file = file or twin_file()
    return diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")


@pytest.fixture(scope="module")
def usual() -> Diagnosis:
    return answer(recordings())


def spoilt(run: RecordedRun, first: int, spoil: Callable[[np.ndarray], np.ndarray]) -> RecordedRun:
    """The run with bad readings from a row on."""
    temps = run.columns["temp_air_c"].copy()
    temps[first : first + BAD] = spoil(temps[first : first + BAD])
    return change_run(run, temp_air_c=temps)


def bad(runs: Sequence[RecordedRun]) -> Sequence[RecordedRun]:
    """Readings that are stuck at the start of a run, in the middle of another; missing and spiked ones."""
    holes = spoilt(runs[2], 20, lambda temps: np.full(len(temps), np.nan))
    return [
        spoilt(runs[0], 0, lambda temps: np.full(len(temps), temps[0])),
        spoilt(runs[1], 40, lambda temps: np.full(len(temps), temps[0])),
        spoilt(holes, 50, lambda temps: temps + np.where(np.arange(len(temps)) % 2, 8.0, 0.0)),
    ]


def shuffled(runs: Sequence[RecordedRun]) -> Sequence[RecordedRun]:
    """In another order, a year later, and the first recording as two files."""
    later = [change_run(run, {"start_utc": "2027-07-01T08:00:00Z"}) for run in runs]
    parts = [cut(later[0], 0, ROWS // 2), cut(later[0], ROWS // 2, ROWS)]
    halves = [replace(part, path=later[0].path.with_suffix(f".{i}")) for i, part in enumerate(parts)]
    return [later[2], *halves, later[1]]


@pytest.mark.parametrize("change", [bad, shuffled])
def test_the_names_stay_and_their_values_within_their_intervals(change: Change, usual: Diagnosis) -> None:
    same(usual, answer(change(recordings())))


def begun(ua_w_k: float, capacities: float) -> TwinFile:
    """Return the twin with its loss and its store open, and where their fit begins."""
    places = {("effects", "wall_loss", "UA"): ua_w_k, ("effects", "extra_capacity", "kC"): capacities}
    return twin_file().with_values({place: Value(value, fit=True) for place, value in places.items()})


def test_where_a_fit_begins_does_not_matter() -> None:
    same(answer(recordings(), begun(0.4, 100.0)), answer(recordings(), begun(40.0, 1.5)))


def same(one: Diagnosis, other: Diagnosis) -> None:
    """The same names, each value inside the other's interval."""
    names = [effect.name for effect in one.verdict.effects]
    assert names == ["heater_lag"]
    assert [effect.name for effect in other.verdict.effects] == names
    for effect, again in zip(one.verdict.effects, other.verdict.effects, strict=True):
        for key, value in effect.parameters.items():
            assert value.low is not None
            assert value.high is not None
            assert value.low <= again.parameters[key].value <= value.high
