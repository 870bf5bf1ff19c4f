"""The recorded runs, by what each is for: `data/README.md` says how they were made."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun, cut, data_sha256, read_run, refuse_test

__all__ = ["Split", "data_sha256", "refuse_test", "regimes_of", "split", "test_run", "training_runs"]

RUNS = Path(__file__).parent / "runs"
REGIMES = ("interpolation", "extrapolation")
SCENARIOS = range(1, 7)  # paper, Table "Model experiment scenarios"
EXTRAPOLATION_MAX_C = 29.7  # the paper's: what extrapolation models were trained on ends here
TRAIN_SHARE = 0.8  # of a run's rows, where the run does not say it


@dataclass(frozen=True, slots=True)
class Split:
    """Whole runs or parts of them; each part begins at time 0 and knows nothing of the other."""

    train: list[RecordedRun]
    validate: list[RecordedRun]


def training_runs(regime: str) -> list[RecordedRun]:
    """Return the training runs in order: all of them, or for
    "extrapolation" those that stay low from end to end.

    Errors : DataError for another regime, and where there are no runs
    """
    if regime not in REGIMES:
        raise DataError(f"regime: {regime!r} is none of {REGIMES}")
    runs = [read_run(path) for path in sorted(RUNS.glob("run_*.csv"))]
    if not runs:
        raise DataError(f"{RUNS}: no run files: record them with `python -m training.data.record`")
    for run in runs:
        refuse_test(run)
    return [run for run in runs if regime in regimes_of(run)]


def regimes_of(run: RecordedRun) -> tuple[str, ...]:
    """Return the regimes whose models train on this run. A missing reading counts as hot."""
    low = bool((run.columns["temp_air_c"] <= EXTRAPOLATION_MAX_C).all())
    return REGIMES if low else REGIMES[:1]


def test_run(scenario: int) -> RecordedRun:
    """The run of scenario 1 to 6, for judging alone. Errors: DataError."""
    if scenario not in SCENARIOS:
        raise DataError(f"scenario: {scenario!r} is none of {SCENARIOS.start} to {SCENARIOS.stop - 1}")
    run = read_run(RUNS / f"scenario_{scenario}.csv")
    if run.facts.get("role") != "test":
        raise DataError(
            f"{run.path}: role: {run.facts.get('role')!r}, but a scenario is judged on a test run"
        )
    return run


def split(run: RecordedRun) -> Split:
    """Split the run in time, training part first: where its `validate_from_s` says, else at 80 % of its rows.

    A run of role validate is one whole validation part. No row is in both parts, so no window or step of one
    reaches into the other.
    Errors : DataError for a test run, and where a part would have less than two rows
    """
    refuse_test(run)
    if run.facts.get("role") == "validate":
        return Split([], [run])
    first = _first_validation_row(run)
    if not 2 <= first <= len(run) - 2:
        raise DataError(f"{run.path}: validate_from_s: a part of less than two rows is none")
    return Split([_part(run, 0, first, "train")], [_part(run, first, len(run), "validate")])


def _first_validation_row(run: RecordedRun) -> int:
    text = run.facts.get("validate_from_s")
    if text is None:
        return int(TRAIN_SHARE * len(run))
    try:
        return int(np.sum(run.columns["time_s"] < float(text)))
    except ValueError:
        raise DataError(f"{run.path}: validate_from_s: {text!r} is no number") from None


def _part(run: RecordedRun, begin: int, end: int, role: str) -> RecordedRun:
    """Rows begin to end - 1 as a run of their own."""
    part = cut(run, begin, end)
    facts = {key: value for key, value in part.facts.items() if key != "validate_from_s"} | {"role": role}
    return replace(part, facts=facts)
