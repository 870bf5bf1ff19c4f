"""python -m bench.real_diagnosis: what a twin of one mass lacks of two boxes that somebody else measured.

Logs of a heated plywood box and of a small lab kit (not part of this repository) become run files, the twin
is one thermal mass whose capacity and loss are to be fitted; the workflow of `greenhouse twin diagnose` sees
time, temperature and duty alone. Rules, set before anything was run on them:

- first part: 60 % of the rows of each run train, the rest is held out (so the data's own notes divide them).
  The room was not measured; it is one constant a run, so a rest has the room of its own first part.
- first runs: the 8 first by date train, 6 later ones are held out. The room of another day is a guess.

Errors are those of free runs. An effect that is named is refuted where held-out runs fit worse with it.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.real_diagnosis_logs import LOG_SETS, RULES, Logs, LogSet, Part, one_mass, read_logs, write_case
from bench.real_diagnosis_plate import Heated, Plate, heated, plate_of
from edge.errors import DataError
from edge.twin.diagnosis.diagnose import Diagnosis, diagnose
from edge.twin.diagnosis.gap import Forecast, errors, forecast
from edge.twin.diagnosis.given import Given
from edge.twin.diagnosis.runs import DiagnosisRuns, NamedRun, read_runs
from edge.twin.model import Twin
from edge.twin.network import HEATER
from edge.twin.twin_file import read_twin_file

Floats = NDArray[np.float64]
FILE = "real_diagnosis.txt"
CASES = (("heated_box", "first part"), ("heated_box", "first runs"), ("tclab", "first part"))


@dataclass(frozen=True, slots=True)
class Step:
    """A twin's free-run RMSE [K]."""

    text: str
    train_k: float
    test_k: float


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """given : the one mass as it fits best; steps : the workflow's waterfall, its first the one mass again

    plate : None where the verdict could not be checked on one
    """

    diagnosis: Diagnosis
    given: Step
    steps: tuple[Step, ...]
    plate: Plate | None

    @property
    def refuted(self) -> list[str]:
        """Effects with which held-out runs fit worse."""
        pairs = zip(self.steps, self.steps[1:], strict=False)
        return [after.text for before, after in pairs if after.test_k > before.test_k]


def measured(folder: Path, log_set: LogSet, logs: Logs) -> Result:
    """One case from files to figures. Errors: DataError"""
    train, test, twin = write_case(folder, log_set, logs)
    file = read_twin_file(twin)
    data = read_runs(train, test, file)
    found = diagnose(file, data, lambda _: None, "")
    names = tuple(effect.name for effect in found.verdict.effects)
    steps = tuple(_step(found, names[:count], logs) for count in range(len(names) + 1))
    return Result(found, _given(log_set, data), steps, _plate(found, logs, log_set))


def _given(log_set: LogSet, data: DiagnosisRuns) -> Step:
    """The one mass by least squares over its free runs, with one room for all of them."""
    fit = one_mass(log_set, [named.run for named in data.train])
    twin, room = fit.file.twin(), fit.ambient_c.value if fit.ambient_c else np.nan

    def free(runs: Sequence[NamedRun]) -> list[Forecast]:
        return [forecast(twin, named, np.full(len(named.run), room)) for named in runs]

    return Step("one mass, least squares over free runs", _rmse(free(data.train)), _rmse(free(data.test)))


def _step(found: Diagnosis, names: tuple[str, ...], logs: Logs) -> Step:
    twin, known = _fitted(found, names)
    free = _free(twin, known, logs, found.data.test)
    text = f"+ {names[-1]}" if names else "one mass, as the workflow fits it"
    return Step(text, _rmse(free[0]), _rmse(free[1]))


def _fitted(found: Diagnosis, names: tuple[str, ...]) -> tuple[Twin, Given]:
    """The set with no more than these effects, and the runs with the rooms that fit it."""
    item = final = found.verdict.final
    for name in sorted(final.added - set(names)):
        item = found.search.without(item, name)
    moved = [
        own - last
        for own, last, term in zip(
            item.fitted.sizes, final.fitted.sizes, final.fitted.trial.nuisances, strict=False
        )
        if term.of_room
    ]
    runs = found.known.runs
    rooms = replace(runs, ambient=runs.ambient + np.array(moved)[:, None])
    return item.fitted.file.twin(), replace(found.known, runs=rooms)


def _free(
    twin: Twin, known: Given, logs: Logs, test: Sequence[NamedRun]
) -> tuple[list[Forecast], list[Forecast]]:
    """Free runs over training and held-out runs."""
    train = [forecast(twin, named, known.room_of(named)) for named in known.as_fitted()]
    return train, [forecast(twin, named, room_of(i, named, known, logs)) for i, named in enumerate(test)]


def room_of(i: int, named: NamedRun, known: Given, logs: Logs) -> Floats:
    """Of held-out run i [rows]: that of its own first part where it has one, else as the workflow guesses."""
    if not logs.same_runs:
        return known.room_of(named)
    return np.full(len(named.run), known.runs.ambient[known.names.index(logs.train[i].name), 0])


def _rmse(free: Sequence[Forecast]) -> float:
    found = errors(free)
    return float("nan") if found is None else float(found["rmse_k"])


def _plate(found: Diagnosis, logs: Logs, log_set: LogSet) -> Plate | None:
    """None where there is no plate, or no heater's state was named."""
    names = tuple(effect.name for effect in found.verdict.effects)
    twin, known = _fitted(found, names)
    if not log_set.plate or HEATER not in twin.states:
        return None
    train, test = _free(twin, known, logs, found.data.test)
    rooms = [known.room_of(named) for named in known.as_fitted()]
    late = [room_of(i, named, known, logs) for i, named in enumerate(found.data.test)]
    return plate_of(
        _heated(twin, train, logs.train, rooms, log_set.plate),
        _heated(twin, test, logs.test, late, log_set.plate),
    )


def _heated(
    twin: Twin, free: Sequence[Forecast], parts: Sequence[Part], rooms: Sequence[Floats], plate: str
) -> list[Heated]:
    return [
        heated(twin, guess, part.run.columns["heater_duty"], room, part.run.columns[plate])
        for guess, part, room in zip(free, parts, rooms, strict=True)
    ]


def lines_of(folder: str, rule: str, logs: Logs, result: Result) -> list[str]:
    """The table of a case."""
    verdict = result.diagnosis.verdict
    count = f"{len(logs.train)} parts" if logs.same_runs else f"{len(logs.train)} runs"
    lines = [f"## {folder}, {rule}: {count} train, {len(logs.test)} held out"]
    lines.append(f"  {'free-run RMSE [K]':42}{'train':>8}{'held out':>10}")
    lines += [
        f"  {step.text:42}{step.train_k:8.3f}{step.test_k:10.3f}" for step in (result.given, *result.steps)
    ]
    lines.append(f"  verdict: {verdict.kind}")
    for effect in verdict.effects:
        values = ", ".join(
            f"{name} {value.value:.3g} ({value.low:.3g} to {value.high:.3g})"
            for name, value in effect.parameters.items()
        )
        rivals = ", ".join(effect.alternatives) or "none"
        lines.append(
            f"    {effect.name}: {values}; log odds {effect.log_odds:.1f}; can't be told from: {rivals}"
        )
    lines.append(f"  refuted by held-out runs: {', '.join(result.refuted) or 'none'}")
    last = result.steps[-1].test_k
    lines.append(
        f"  held-out error over that of one mass: 1/{result.given.test_k / last:.1f} of the best fitted one, "
        f"1/{result.steps[0].test_k / last:.1f} of the workflow's"
    )
    return lines + _plate_lines(result.plate)


def _plate_lines(plate: Plate | None) -> list[str]:
    if plate is None:
        return []
    return [
        f"  plate, never told: {plate.warmer_k_w:.2f} K/W above the air, correlation "
        f"{plate.correlation:.4f}, {100.0 * plate.explained:.1f} % of its variance explained, held-out rows"
    ]


def main(words: Sequence[str] | None = None) -> int:
    """Print the table and save it; 2 where the data are missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.real_diagnosis", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("bench/results"))
    parser.add_argument("--keep", type=Path, help="folder for run files and twins, else they are thrown away")
    arguments = parser.parse_args(words)
    lines = ["python -m bench.real_diagnosis", ""]
    with tempfile.TemporaryDirectory(prefix="greenhouse-real-") as temporary:
        for folder, rule in CASES:
            begun = time.monotonic()
            place = (arguments.keep or Path(temporary)) / folder / rule.replace(" ", "_")
            try:
                logs = read_logs(arguments.data, LOG_SETS[folder], RULES[rule])
                result = measured(place, LOG_SETS[folder], logs)
            except DataError as error:
                print(error, file=sys.stderr)
                return 2
            lines += [*lines_of(folder, rule, logs, result), f"  took {time.monotonic() - begun:.0f} s", ""]
    print("\n".join(lines))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / FILE).write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
