"""Invariance of a diagnosis: a few bad readings, the order of the runs, the start of a fit."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.formats.run_file import RecordedRun, cut
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import BOX, as_diagnosis_runs, change_run, silent, simulate, twin_file

pytestmark = pytest.mark.slow

HIDDEN = {"heater_lag": {"tau_h": 300.0}}
ROWS, BAD = 120, 10
Change = Callable[[Sequence[RecordedRun]], Sequence[RecordedRun]]


def recordings() -> list[RecordedRun]:
    return [simulate({**BOX, **HIDDEN}, seed, ROWS) for seed in (1, 2, 3)]


def answer(runs: Sequence[RecordedRun], file: TwinFile | None = None) -> Diagnosis:
    file = file or twin_file()
    return diagnose(file, as_diagnosis_runs(runs, file=file), silent, "")


@pytest.fixture(scope="module")
def usual() -> Diagnosis:
    return answer(recordings())


def bad(run: int, first: int, spoil: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Readings of one run from a row on."""

    def change(runs: Sequence[RecordedRun]) -> Sequence[RecordedRun]:
        temps = runs[run].columns["temp_air_c"].copy()
        temps[first : first + BAD] = spoil(temps[first : first + BAD])
        return [change_run(item, temp_air_c=temps) if i == run else item for i, item in enumerate(runs)]

    return change


def split(runs: Sequence[RecordedRun]) -> Sequence[RecordedRun]:
    """The first recording as two files."""
    parts = [cut(runs[0], 0, ROWS // 2), cut(runs[0], ROWS // 2, ROWS)]
    return [replace(part, path=runs[0].path.with_suffix(f".{i}")) for i, part in enumerate(parts)] + list(
        runs[1:]
    )


CHANGES: dict[str, Change] = {
    "shuffled": lambda runs: [runs[2], runs[0], runs[1]],
    "begun a year later": lambda runs: [
        change_run(run, {"start_utc": "2027-07-01T08:00:00Z"}) for run in runs
    ],
    "split in two": split,
    "stuck at the start": bad(0, 0, lambda temps: np.full(len(temps), temps[0])),
    "stuck in the middle": bad(1, 60, lambda temps: np.full(len(temps), temps[0])),
    "missing": bad(2, 40, lambda temps: np.full(len(temps), np.nan)),
    "spiked": bad(0, 70, lambda temps: temps + np.where(np.arange(len(temps)) % 2, 8.0, 0.0)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_the_names_stay_and_their_values_within_their_intervals(name: str, usual: Diagnosis) -> None:
    same(usual, answer(CHANGES[name](recordings())))


def begun(ua_w_k: float, capacities: float) -> TwinFile:
    """Return the twin with its loss and its store open, and where their fit begins."""
    places = {("effects", "wall_loss", "UA"): ua_w_k, ("effects", "extra_capacity", "kC"): capacities}
    return twin_file().with_values({place: Value(value, fit=True) for place, value in places.items()})


@pytest.fixture(scope="module")
def begun_near() -> Diagnosis:
    return answer(recordings(), begun(4.0, 10.0))


@pytest.mark.parametrize(("ua_w_k", "capacities"), [(0.4, 100.0), (40.0, 1.5)])
def test_where_a_fit_begins_does_not_matter(ua_w_k: float, capacities: float, begun_near: Diagnosis) -> None:
    same(begun_near, answer(recordings(), begun(ua_w_k, capacities)))


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
