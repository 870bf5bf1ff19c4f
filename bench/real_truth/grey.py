"""python -m bench.real_truth.grey: grey boxes chosen by left-out rows, compared with a script.

The script is `least_squares.py` of the folder `yardstick` that lies beside the checkout: five grey boxes by
the fit's error alone. It gets the same rows at the same step. `held out` is the error of free runs over what
no fit saw [K]: from the training part on, or from the first row of a run in balance with it.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.header import header
from bench.real_truth.__main__ import TRAINS, folder_name
from bench.real_truth.logs import LOGS, RealLog, texts
from edge.core.errors import DataError
from edge.diagnosis.choose import GreyChoice, choose
from edge.diagnosis.fit import GreyBox, rms
from edge.diagnosis.grey_run import GreyRun, grey_runs, reading_noise_k, usual_step_s
from edge.formats.run_file import RecordedRun

Floats = NDArray[np.float64]
SAID = re.compile(r": (\w+) is the simplest within .* held out ([\d.e+-]+) K")
NO_WORSE = 1.05


class GreyCase(NamedTuple):
    """splits : rows of each run before its test part, None where runs train or test as wholes"""

    train: list[GreyRun]
    test: list[GreyRun]
    splits: list[int] | None
    step_s: float
    noise_k: float


def case(log: RealLog, files: Sequence[str]) -> GreyCase:
    """Return the rows that are fitted and judged."""
    runs = [RecordedRun(columns) for columns in map(log.read, files)]
    tests = len(runs) // 3 if log.whole else 0
    fitted = runs[: len(runs) - tests]
    step_s, noise_k = usual_step_s(fitted), reading_noise_k(fitted)
    every = grey_runs(runs, step_s, noise_k)
    if tests:
        return GreyCase(every[:-tests], every[-tests:], None, step_s, noise_k)
    splits = [
        int(
            np.searchsorted(
                step_s * np.arange(len(own.temp)), run.columns["time_s"][round(TRAINS * len(run))]
            )
        )
        for own, run in zip(every, runs, strict=True)
    ]
    train = [run.until(rows) for run, rows in zip(every, splits, strict=True)]
    whole = [replace(run, at_rest=own.at_rest) for run, own in zip(every, train, strict=True)]
    return GreyCase(train, whole, splits, step_s, noise_k)


def held_out_k(box: GreyBox, given: GreyCase) -> float:
    """Return the error over the rows that are judged by [K]."""
    missed = []
    for i, run in enumerate(given.test):
        start = box.start_of(run) if given.splits is None else box.starts[i]
        first = 0 if given.splits is None else given.splits[i]
        missed.append((run.temp - box.free_run(run, start))[first:])
    return rms(np.concatenate(missed))


def yardstick(script: Path, given: GreyCase, folder: Path) -> tuple[str, float]:
    """Return the model that the script chooses and its error over the same rows [K]. Errors: DataError"""
    folder.mkdir()
    runs = [*given.test] if given.splits is not None else [*given.train, *given.test]
    for i, run in enumerate(runs):
        role = "train" if i < len(given.train) else "test"
        facts = "# at_rest: yes\n" if all(own.at_rest for own in runs) else ""
        if given.splits is not None:
            facts += f"# validate_from_s: {given.splits[i] * given.step_s}\n"
        name = "run" if given.splits is not None and i == 0 else f"{role}_{i:02}"
        (folder / f"{name}.csv").write_text(facts + _csv(run, given.step_s), encoding="utf-8")
    command = [sys.executable, str(script), str(folder)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    said = SAID.search(found.stdout)
    if said is None:
        raise DataError(f"{script.name}: {found.stderr.strip().splitlines()[-1:]}")
    return said[1], float(said[2])


def _csv(run: GreyRun, step_s: float) -> str:
    columns = {"time_s": step_s * np.arange(len(run.temp)), "temp_air_c": run.temp, "heater_duty": run.duty}
    if run.room is not None:
        columns["temp_ambient_c"] = run.room
    if run.fan is not None:
        columns["fan_on"] = run.fan
    columns |= dict(zip(("solar_w_m2", "light"), run.others, strict=False))
    known = np.isfinite(run.temp)
    rows = np.column_stack(list(columns.values()))
    rows[:, 1] = np.interp(rows[:, 0], rows[known, 0], run.temp[known])  # the script knows no hole
    lines = (",".join(f"{value:.8g}" for value in row) for row in rows)
    return "\n".join([",".join(columns), *lines]) + "\n"


def line(
    log: RealLog, given: GreyCase, found: GreyChoice, cpu_s: float, rival: tuple[str, float] | None
) -> str:
    """Return what is printed of a log."""
    own_k, rows = held_out_k(found.box, given), sum(len(run.temp) for run in given.train)
    words = f"{log.name}: {rows} rows of {given.step_s:.3g} s: {name(found)} {own_k:.3g} K, {cpu_s:.0f} s"
    return words if rival is None else f"{words}; script: {rival[0]} {rival[1]:.3g} K, {own_k / rival[1]:.2f}"


def name(found: GreyChoice) -> str:
    """Return the terms of a grey box in words."""
    return " + ".join(sorted(found.terms)) or "one mass"


def main(words: Sequence[str] | None = None) -> int:
    """Print a line a log, and the geometric mean of the errors' ratio."""
    parser = argparse.ArgumentParser(prog="python -m bench.real_truth.grey", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="logs of the folder README")
    parser.add_argument("--repositories", type=Path, default=Path("../repositories"), help="clones of others")
    parser.add_argument("--yardstick", type=Path, help="least_squares.py, to compare with")
    parser.add_argument("--split", choices=("dev", "scored", "kept"), nargs="+", default=["dev", "scored"])
    parser.add_argument("--only", help="logs with this in their names")
    given = parser.parse_args(words)
    print("\n".join(header()))
    ratios = []
    for log in LOGS:
        if log.split not in given.split or (given.only or "") not in log.name:
            continue
        try:
            rows = case(log, texts(log, given.data, given.repositories))
            begun_s = time.process_time()
            found = choose(rows.train, rows.step_s, rows.noise_k)
            cpu_s, rival = time.process_time() - begun_s, None
            if given.yardstick is not None:
                with tempfile.TemporaryDirectory() as folder:
                    rival = yardstick(given.yardstick, rows, Path(folder) / folder_name(log))
                ratios.append(held_out_k(found.box, rows) / rival[1])
        except DataError as error:
            print(f"{log.name}: left out: {error}", flush=True)
            continue
        print(line(log, rows, found, cpu_s, rival), flush=True)
    if ratios:
        mean, kept = float(np.exp(np.mean(np.log(ratios)))), sum(each <= NO_WORSE for each in ratios)
        print(f"geometric mean of the ratio {mean:.3f}; at most {NO_WORSE} in {kept} of {len(ratios)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
