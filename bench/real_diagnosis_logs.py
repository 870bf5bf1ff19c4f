"""Two sets of measured logs as run files of a diagnosis, and a twin that knows as little of them as we do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edge.core.errors import DataError
from edge.formats.run_file import (
    OPTION_WITHOUT,
    RecordedRun,
    absence_facts,
    cut,
    read_run,
    resample,
    write_run,
)
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import TwinFit, fit_twin
from edge.twin.twin_file import TwinFile, write_twin_file
from edge.twin.value import Value

FIRST_SHARE = 0.6  # of a run, that trains; the rest is held out
FIRST_RUNS = 8  # by date, of heated_box: what fits and chooses in bench/real_logs.py
VOLUME_M3 = 0.03  # any: the fitted capacity is a multiple of its air's
GIVEN = ("extra_capacity", "wall_loss")  # one thermal mass, losing heat to the room
TOLD = ("time_s", "temp_air_c", "heater_duty")  # the plate's and the second heater's columns are left out


@dataclass(frozen=True, slots=True, eq=False)
class LogPart:
    """A recording with all that was measured.

    name : of its run file; judged_from_s : what is before trains, the rest is held out [s]; None: it is whole
    """

    name: str
    run: RecordedRun
    judged_from_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Logs:
    """train, test : recordings; the same ones where each is divided"""

    train: tuple[LogPart, ...]
    test: tuple[LogPart, ...]


Rule = Callable[[Sequence[tuple[str, RecordedRun]]], Logs]


@dataclass(frozen=True, slots=True)
class LogSet:
    """A folder of logs.

    left_out : recordings that are another one again
    step_s : the twin's; heater_w : what is known of the power, else any: with it goes the scale of capacity
        and loss, of which a temperature and a duty tell the ratios alone
    plate : column of the heater's own temperature, "" where it was not measured
    """

    folder: str
    step_s: float
    heater_w: float
    plate: str = ""
    left_out: tuple[str, ...] = ()


LOG_SETS = {
    # 12 V and less than 3.5 A; ten minutes a run, and rows 1 s apart are more than one mass needs
    "heated_box": LogSet("heated_box", 5.0, 42.0, "temp_plate_c"),
    # half of the logs have rows 3 s apart; higher_order.csv is energy_balance.csv rounded to 0.1 degC
    "tclab": LogSet("tclab", 3.0, 100.0, left_out=("higher_order",)),
}


def first_part(runs: Sequence[tuple[str, RecordedRun]]) -> Logs:
    """Train on the first FIRST_SHARE of the rows of each run and hold the rest out."""
    parts = tuple(
        LogPart(f"{name}.csv", run, float(run.columns["time_s"][round(FIRST_SHARE * len(run))]))
        for name, run in runs
    )
    return Logs(parts, parts)


def first_runs(runs: Sequence[tuple[str, RecordedRun]]) -> Logs:
    """Train on the first FIRST_RUNS by name, which begins with the date; hold later ones out."""
    parts = [LogPart(f"{name}.csv", run) for name, run in runs]
    return Logs(tuple(parts[:FIRST_RUNS]), tuple(parts[FIRST_RUNS:]))


RULES: dict[str, Rule] = {"first part": first_part, "first runs": first_runs}


def read_logs(data: Path, log_set: LogSet, rule: Rule) -> Logs:
    """Read the recordings at the twin's step (readings at its instants, duty the mean over it), divided.

    Errors : DataError where there are none
    """
    paths = sorted((data / log_set.folder).glob("*.csv"))
    runs = [
        (path.stem, read_run(path, OPTION_WITHOUT)) for path in paths if path.stem not in log_set.left_out
    ]
    if not runs:
        raise DataError(f"{data / log_set.folder}: no run files; see README.md, where they are from")
    return rule([(name, resample(run, log_set.step_s)) for name, run in runs])


def write_case(folder: Path, log_set: LogSet, logs: Logs) -> tuple[list[Path], list[Path], Path]:
    """Training runs, held-out runs and the twin that is given, as files. Errors: DataError"""
    folder.mkdir(parents=True, exist_ok=True)
    train = _write(folder, logs.train, "train")
    test = train if logs.test is logs.train else _write(folder, logs.test, "test")
    twin = folder / "twin.yaml"
    first = [_until(part) for part in logs.train]
    write_twin_file(given_twin(log_set, first), twin)
    return train, test, twin


def _until(part: LogPart) -> RecordedRun:
    """Return the part of a recording that trains."""
    if part.judged_from_s is None:
        return part.run
    return cut(part.run, 0, int((part.run.columns["time_s"] < part.judged_from_s).sum()))


def _write(folder: Path, parts: Sequence[LogPart], role: str) -> list[Path]:
    paths = []
    for part in parts:
        columns = {name: part.run.columns[name] for name in TOLD}
        facts = {"role": role}
        if part.judged_from_s is not None:
            facts["validate_from_s"] = f"{part.judged_from_s:g}"
        write_run(absence_facts(replace(part.run, columns=columns, facts=facts)), folder / part.name)
        paths.append(folder / part.name)
    return paths


def one_mass(log_set: LogSet, runs: Sequence[RecordedRun]) -> TwinFit:
    """Fit the twin of one mass with a loss, by least squares over its free runs, with one room.

    There is no fan: that of heated_box stirs the air inside and never stops, tclab has none.
    """
    effects = {
        name: {item.name: Value(item.start, fit=True) for item in EFFECTS[name].parameters} for name in GIVEN
    }
    known = {"heater_max_w": Value(log_set.heater_w), "volume_m3": Value(VOLUME_M3)}
    file = TwinFile(geometry={**TwinFile().geometry, **known}, sample_s=log_set.step_s, effects=effects)
    return fit_twin(
        file, [replace(run, columns={**run.columns, "fan_on": np.zeros(len(run))}) for run in runs]
    )


def given_twin(log_set: LogSet, runs: Sequence[RecordedRun]) -> TwinFile:
    """Return the one mass, its two values still to be fitted, from where it fits best."""
    file = one_mass(log_set, runs).file
    values = {
        place: Value(value.value, fit=True) for place, value in file.values().items() if place[0] == "effects"
    }
    return replace(file.with_values(values), provenance={})
