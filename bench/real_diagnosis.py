"""python -m bench.real_diagnosis: what a twin of one mass lacks of two boxes that somebody else measured.

Logs of a heated plywood box and of a small lab kit (not part of this repository) become run files, the twin
is one thermal mass whose capacity and loss are to be fitted; the workflow of `greenhouse twin diagnose` sees
time, temperature and duty alone.

- first part: 60 % of the rows of each run train, the rest is held out (so the data's own notes divide them).
- first runs: the 8 first by date train, 6 later ones are held out. The room, which nobody measured, is one
  constant a run; that of another day is a guess.

Errors are those of free runs; those of a held-out part go on from what was known before it. An effect that
is named is refuted where held-out runs fit worse with it.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.real_diagnosis_logs import LOG_SETS, RULES, LogPart, Logs, LogSet, one_mass, read_logs, write_case
from bench.real_diagnosis_plate import HeaterStates, Plate, heater_states, plate_of
from edge.core.errors import DataError
from edge.diagnosis.diagnose import Diagnosis, Side, diagnose
from edge.diagnosis.gap import RunForecast, errors, forecast
from edge.diagnosis.runs import DiagnosisRuns, NamedRun, read_runs
from edge.twin.network import HEATER
from edge.twin.twin_file import read_twin_file

FILE = "real_diagnosis.txt"
CASES = (("heated_box", "first part"), ("heated_box", "first runs"), ("tclab", "first part"))


@dataclass(frozen=True, slots=True)
class Step:
    """A twin's free-run RMSE [K]."""

    text: str
    train_k: float
    test_k: float


@dataclass(frozen=True, slots=True, eq=False)
class LogResult:
    """given : the one mass as it fits best; steps : the workflow's waterfall, its first the one mass again

    plate : None where the verdict could not be checked on one
    """

    diagnosis: Diagnosis
    given_step: Step
    steps: tuple[Step, ...]
    plate: Plate | None

    @property
    def refuted(self) -> list[str]:
        """Effects with which held-out runs fit worse."""
        pairs = zip(self.steps, self.steps[1:], strict=False)
        return [after.text for before, after in pairs if after.test_k > before.test_k]


def measure(folder: Path, log_set: LogSet, logs: Logs) -> LogResult:
    """One case from files to figures. Errors: DataError"""
    train, test, twin = write_case(folder, log_set, logs)
    file = read_twin_file(twin)
    data = read_runs(train, test, file)
    found = diagnose(file, data, lambda _, __: None, "")
    steps = tuple(_step(names, side) for names, side in found.steps)
    return LogResult(found, _given_step(log_set, data), steps, _plate(found, logs, log_set))


def _given_step(log_set: LogSet, data: DiagnosisRuns) -> Step:
    """Fit the one mass by least squares over its free runs, with one room for all of them."""
    fit = one_mass(log_set, [named.run for named in data.train])
    twin, room = fit.file.twin(), fit.ambient_c.value if fit.ambient_c else np.nan

    def free(runs: Sequence[NamedRun]) -> list[RunForecast]:
        return [forecast(twin, named, np.full(len(named.run), room)) for named in runs]

    return Step("one mass, least squares over free runs", _rmse(free(data.train)), _rmse(free(data.test)))


def _step(names: tuple[str, ...], side: Side) -> Step:
    text = f"+ {names[-1]}" if names else "one mass, rooms as the workflow fits them"
    return Step(text, _rmse(side.train), _rmse(side.test))


def _rmse(free: Sequence[RunForecast]) -> float:
    found = errors(free)
    rmse_k = None if found is None else found["rmse_k"]
    return float("nan") if rmse_k is None else rmse_k


def _plate(found: Diagnosis, logs: Logs, log_set: LogSet) -> Plate | None:
    """None where there is no plate, or no heater's state was named."""
    side = found.after
    if not log_set.plate or HEATER not in side.file.twin().states:
        return None
    train, test = found.inputs.as_fitted(), found.data.test
    return plate_of(
        _heater_states(found, train, side.train, logs.train, log_set.plate),
        _heater_states(found, test, side.test, logs.test, log_set.plate),
    )


def _heater_states(
    found: Diagnosis,
    runs: Sequence[NamedRun],
    free: Sequence[RunForecast],
    parts: Sequence[LogPart],
    plate: str,
) -> list[HeaterStates]:
    twin = found.after.file.twin()
    return [
        heater_states(
            twin,
            guess,
            named.run.columns["heater_duty"],
            found.inputs.room_of(named),
            part.run.columns[plate],
        )
        for named, guess, part in zip(runs, free, parts, strict=True)
    ]


def lines_of(folder: str, rule: str, logs: Logs, result: LogResult) -> list[str]:
    """Return the table of a case."""
    verdict = result.diagnosis.verdict
    what = "parts" if logs.train is logs.test else "runs"
    lines = [f"## {folder}, {rule}: {len(logs.train)} {what} train, {len(logs.test)} held out"]
    lines.append(f"  {'free-run RMSE [K]':42}{'train':>8}{'held out':>10}")
    lines += [
        f"  {step.text:42}{step.train_k:8.3f}{step.test_k:10.3f}"
        for step in (result.given_step, *result.steps)
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
    shrunk = result.given_step.test_k / result.steps[-1].test_k
    lines.append(f"  held-out error of the one mass over the last: {shrunk:.1f}")
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
                result = measure(place, LOG_SETS[folder], logs)
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
