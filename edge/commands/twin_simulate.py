"""`greenhouse twin simulate`: free run of a twin over recorded runs.

From the first rows of a run on its air temperature is not used any more; inputs and room temperature are.
"""

import argparse
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from edge.commands.arguments import add_absent_columns, number, whole, writing
from edge.core.errors import DataError, RequestError
from edge.diagnosis.readings import plausible_run
from edge.formats.atomic_file import make_folder
from edge.formats.number_table import print_table, read_table
from edge.formats.run_file import RecordedRun, inside_names, resample, write_run
from edge.formats.run_lines import OPTION_WITHOUT
from edge.models.pbm import Pbm, read_twin
from edge.twin.warm_start import hold

START_ROWS = 10
DECIMALS = 4  # of a prediction [°C]
PREDICTED = "predicted_c"
FIRST = ("time_s", "temp_air_c", PREDICTED, "temp_ambient_c", "heater_duty", "fan_on")

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SimulationErrors:
    """Errors of a free run over rows both forecast and measured [K]; NaN without any."""

    rmse_k: float
    mae_k: float
    rows: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the action."""
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN.csv", help="recorded run")
    parser.add_argument("--twin", type=Path, required=True, help="twin file with every value known")
    parser.add_argument(
        "--out",
        type=Path,
        help="run file to write, or folder for one each; default: CSV on standard output",
    )
    parser.add_argument(
        "--start-rows",
        type=whole(1),
        default=START_ROWS,
        help=f"first rows whose temperatures give the start; default: {START_ROWS}",
    )
    # No default: a guessed room would look like a measured one in the forecast.
    parser.add_argument(
        "--ambient-c",
        type=number(-50.0, 80.0),
        metavar="DEGC",
        help="room temperature of runs that have none [°C]",
    )
    add_absent_columns(parser, "fan_on")
    parser.add_argument(
        "--fan-always-on",
        action="store_true",
        help="take the fan as always on in runs without the column fan_on",
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when every run is simulated; its errors go to standard error where the CSV is on standard output."""
    if arguments.out is None and len(arguments.runs) > 1:
        raise RequestError("--out: several runs need a folder to write into")
    pbm = read_twin(arguments.twin)
    outs = _outs(arguments.runs, arguments.out)
    figures: TextIO = sys.stderr if arguments.out is None else sys.stdout
    without = ["temp_ambient_c", *arguments.without, *(["fan_on"] if arguments.fan_always_on else [])]
    results = {}
    for path, out in zip(arguments.runs, outs, strict=True):
        recorded = _record(path, pbm.step_s, arguments.ambient_c, arguments.fan_always_on, without)
        simulated = simulate(pbm, recorded, arguments.start_rows)
        results[path.name if out is None else str(out)] = errors(simulated)
        _write(replace(simulated, facts={**simulated.facts, **_facts(arguments.twin, pbm)}), out)
    print("\n".join(_table(results)), file=figures)
    return 0


def simulate(pbm: Pbm, run: RecordedRun, start_rows: int = START_ROWS) -> RecordedRun:
    """Return the run with a column `predicted_c`, empty in the rows that it starts from.

    run : at the twin's step, with room temperature and fan
    start_rows : from the first row with a temperature on; the last of them with one is where it starts
    Errors : DataError for a run without a temperature, and for a column that the twin needs
    """
    known = np.flatnonzero(np.isfinite(run.columns["temp_air_c"]))
    if not len(known):
        raise DataError(f"{run.path}: temp_air_c: nothing was measured to start from")
    # The forecast starts at the last row that a temperature stands in, not at the last of the first rows.
    now = int(known[known < known[0] + start_rows][-1])
    columns = inside_names(run)
    columns |= {
        name: hold(values)
        for name, values in columns.items()
        if name not in ("temp_air", "heater_duty", "fan_on")
    }
    history = {name: values[: now + 1] for name, values in columns.items()}
    ahead = {name: values[now:-1] for name, values in columns.items() if name != "temp_air"}
    controls = np.stack([ahead["heater_duty"], ahead["fan_on"]], axis=-1)
    predicted = np.full(len(run), np.nan)
    if len(controls):
        try:
            predicted[now + 1 :] = np.round(pbm.rollout(history, controls[None], ahead)[0], DECIMALS)
        except DataError as error:
            raise DataError(f"{run.path}: {error}") from error
    table = {**run.columns, PREDICTED: predicted}
    ordered = [*FIRST, *(name for name in table if name not in FIRST)]
    return replace(
        run,
        columns={name: table[name] for name in ordered},
        facts={**run.facts, "forecast_from_s": f"{run.columns['time_s'][now]:g}"},
    )


def errors(simulated: RecordedRun) -> SimulationErrors:
    """Return the errors of the free run in a run's `predicted_c`."""
    missed = simulated.columns[PREDICTED] - simulated.columns["temp_air_c"]
    missed = missed[np.isfinite(missed)]
    if not len(missed):
        return SimulationErrors(np.nan, np.nan, 0)
    return SimulationErrors(float(np.sqrt(np.mean(missed**2))), float(np.abs(missed).mean()), len(missed))


def _record(
    path: Path, step_s: float, ambient_c: float | None, fan_always_on: bool, without: Collection[str]
) -> RecordedRun:
    """Return the run at the twin's step with every input of a free run."""
    run, told = plausible_run(read_table(path), without)
    for note in told:
        print(note, file=sys.stderr)
    run = resample(run, step_s)
    ambient = run.columns.get("temp_ambient_c")
    if ambient is None or not np.isfinite(ambient).any():
        if ambient_c is None:
            raise DataError(f"{path}: temp_ambient_c: not known; say what it was with --ambient-c")
        ambient = np.full(len(run), ambient_c)
    fan = run.columns.get("fan_on", np.full(len(run), float(fan_always_on)))
    facts = {name: value for name, value in run.facts.items() if name not in OPTION_WITHOUT}
    return replace(run, columns={**run.columns, "temp_ambient_c": ambient, "fan_on": fan}, facts=facts)


def _outs(runs: Sequence[Path], out: Path | None) -> list[Path | None]:
    """Return the output of each run, None for standard output. Errors:
    RequestError before anything is overwritten
    """
    if out is None:
        return [None]
    if len(runs) == 1 and out.suffix == ".csv" and not out.is_dir():
        outs = [out]
    else:
        with writing(out):
            make_folder(out)
        outs = [out / path.name for path in runs]
    if len(set(outs)) < len(outs):
        raise RequestError("--out: two runs have one name; simulate them one by one")
    recorded = {path.resolve() for path in runs}
    for path in outs:
        if path.resolve() in recorded:
            raise RequestError(f"--out: {path} is a recorded run and is not overwritten")
    return list(outs)


def _write(simulated: RecordedRun, out: Path | None) -> None:
    if out is None:
        print_table(sys.stdout, simulated.columns, simulated.facts)
        return
    with writing(out):
        write_run(simulated, out)


def _facts(twin: Path, pbm: Pbm) -> dict[str, str]:
    return {"twin": twin.name, "twin_sha256": pbm.twin.sha256}


def _table(results: Mapping[str, SimulationErrors]) -> list[str]:
    width = max(len(name) for name in results)
    lines = [f"{'free run':{width}}   rows  rmse_k   mae_k"]
    for name, of_run in results.items():
        figures = f"{of_run.rmse_k:6.3f}  {of_run.mae_k:6.3f}" if of_run.rows else "nothing to compare with"
        lines.append(f"{name:{width}}  {of_run.rows:5d}  {figures}")
    return lines
