"""python -m bench.real_truth: the diagnosis on logs that other people measured, beside four simple models.

A name is right where what is known of the rig says so, and is not judged where nothing is. Errors are those
of free runs over what no fit saw [K]. The twin that is given knows volume and heater; its loss and capacity
are to be fitted. With `--yardstick` the script of the folder `yardstick` that lies beside the checkout gets
the same rows: five grey boxes by least squares, chosen by the fit's error alone.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from bench.foreign.cases import ForeignLog
from bench.foreign.make import write_text
from bench.foreign.run_cases import LIMIT_S, OURS, SolverTask, run_all
from bench.foreign.score import is_alike
from bench.real_truth.logs import LOGS, RealLog, texts
from bench.real_truth.readers import Columns
from edge.core.errors import DataError
from edge.diagnosis.noise import reading_noise_k, rests
from edge.diagnosis.runs import read_runs
from edge.twin.twin_file import read_twin_file

Floats = NDArray[np.float64]
TRAINS = 0.65
SURE = 0.9
DARK_GREY = Path(__file__).with_name("dark_grey.py")
NO_WORSE = 1.05
SAID = re.compile(r": (\w+) is the simplest within .* held out ([\d.e+-]+) K")
SCRIPT_COLUMNS = ("time_s", "temp_air_c", "heater_duty", "temp_ambient_c", "fan_on", "light", "solar_w_m2")


def main(words: Sequence[str] | None = None) -> int:
    """Make the cases, run them, and print a line a log."""
    parser = argparse.ArgumentParser(prog="python -m bench.real_truth", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="logs of the folder README")
    parser.add_argument("--repositories", type=Path, default=Path("../repositories"), help="clones of others")
    parser.add_argument("--yardstick", type=Path, help="least_squares.py, to compare with")
    parser.add_argument("--dark-grey", help="a python that has darkgreybox 0.3.2, to compare with")
    parser.add_argument("--split", choices=("dev", "scored", "kept"), nargs="+", default=["dev"])
    parser.add_argument("--only", help="logs with this in their names")
    parser.add_argument("--out", type=Path, help="keep cases and answers here")
    arguments = parser.parse_args(words)
    logs = [log for log in LOGS if log.split in arguments.split and (arguments.only or "") in log.name]
    with tempfile.TemporaryDirectory() as folder:
        out = arguments.out or Path(folder)
        places = out, arguments.data, arguments.repositories
        text = report(logs, *places, arguments.yardstick, arguments.dark_grey)
    print(text, end="")
    return 0


def report(
    logs: Sequence[RealLog],
    out: Path,
    data: Path,
    repositories: Path,
    script: Path | None = None,
    dark_grey: str | None = None,
) -> str:
    """Cases and answers under `out`; a line a log and what they come to.

    script : least_squares.py; dark_grey : a python that has darkgreybox
    """
    lines, found, ratios = [], [], []
    for log in logs:
        folder = out / "cases" / folder_name(log)
        answer = out / "answers" / folder.name
        try:
            write(log, folder, texts(log, data, repositories))
        except DataError as error:
            lines.append(f"{log.name}: left out: {error}")
            continue
        with redirect_stdout(sys.stderr):  # how far it is; the table is what is printed
            run_all([SolverTask(OURS, folder, answer, LIMIT_S)], 1)
        path = answer / "diagnosis.json"
        run = json.loads((answer / "run.json").read_text(encoding="utf-8"))
        if not path.exists():
            said = run["stderr"].strip().splitlines()[-1:]  # not the traceback: it names this machine
            lines.append(f"{log.name}: no answer: {''.join(said)}")
            continue
        document = json.loads(path.read_text(encoding="utf-8"))
        found.append((log, document))
        lines += _lines(log, document, run)
        if script is not None:
            said, rival_k = peer(sys.executable, script, folder, out / "yardstick" / folder.name)
            ratios.append(_tests(document)["after"] / rival_k)
            lines.append(f"    script: {said} {rival_k:.3g}, ratio {ratios[-1]:.2f}")
        if dark_grey is not None:
            said, rival_k = peer(dark_grey, DARK_GREY, folder, out / "darkgreybox" / folder.name)
            lines.append(f"    DarkGreyBox: {said} {rival_k:.3g}")
    return "\n".join([*lines, "", *_totals(found), *_ratios(ratios)]) + "\n"


def peer(python: str, script: Path, case: Path, folder: Path) -> tuple[str, float]:
    """Return the model that a script chooses and its error over the same rows [K].

    case : as `write` leaves it; folder : for the rows as a script reads them
    Errors : DataError where it does not answer
    """
    train, tests = (sorted(case.glob(f"{role}_*.csv")) for role in ("train", "test"))
    data = read_runs(train, tests or train, read_twin_file(case / "twin.yaml"))
    noise_k = reading_noise_k([named.run for named in data.train])
    folder.mkdir(parents=True, exist_ok=True)
    runs = [("test", named) for named in data.test]
    if tests:
        runs += [("train", named) for named in data.train]
    rest = all(
        rests(named.run.columns["temp_air_c"], named.run.columns["heater_duty"], noise_k) for _, named in runs
    )
    for i, (role, named) in enumerate(runs):
        facts = "# at_rest: yes\n" if rest else ""
        facts += "" if named.from_s is None else f"# validate_from_s: {named.from_s:g}\n"
        name = "run" if not tests and i == 0 else f"{role}_{i:02}"
        (folder / f"{name}.csv").write_text(facts + _csv(named.run.columns), encoding="utf-8")
    command = [python, str(script), str(folder)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    said = SAID.search(found.stdout)
    if said is None:
        raise DataError(f"{script.name}: {found.stderr.strip().splitlines()[-1:]}")
    return said[1], float(said[2])


def _csv(columns: Mapping[str, Floats]) -> str:
    """Rows without holes, which the script does not know."""
    names = [name for name in SCRIPT_COLUMNS if name in columns and np.isfinite(columns[name]).any()]
    time_s = columns["time_s"]
    whole = []
    for name in names:
        known = np.isfinite(columns[name])
        whole.append(np.interp(time_s, time_s[known], columns[name][known]))
    lines = (",".join(f"{value:.8g}" for value in row) for row in np.column_stack(whole))
    return "\n".join([",".join(names), *lines]) + "\n"


def _ratios(ratios: Sequence[float]) -> list[str]:
    if not ratios:
        return []
    mean, kept = float(np.exp(np.mean(np.log(ratios)))), sum(each <= NO_WORSE for each in ratios)
    return [
        f"held out by the script's: {mean:.2f} in the geometric mean",
        f"held out at most {NO_WORSE} of the script's: {kept} of {len(ratios)}",
    ]


def write(log: RealLog, folder: Path, files: Sequence[str]) -> None:
    """Write the files that the workflow is given."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    runs = [log.read(text) for text in files]
    tests = len(runs) // 3 if log.whole else 0
    for i, columns in enumerate(runs):
        role = "test" if i >= len(runs) - tests else "train"
        time_s = columns["time_s"]
        judged = None if log.whole else float(time_s[round(TRAINS * len(time_s))])
        name = f"{role}_{i + 1:02}.csv"
        (folder / name).write_text(write_text(name, ForeignLog(columns, judged)), encoding="utf-8")
    (folder / "twin.yaml").write_text(yaml.safe_dump(_twin(log, runs[0]), sort_keys=False), encoding="utf-8")


def _twin(log: RealLog, first: Columns) -> dict[str, Any]:
    step_s = max(log.step_s, float(np.median(np.diff(first["time_s"]))))
    return {
        "geometry": {"volume_m3": log.volume_m3, "heater_max_w": log.heater_w},
        "fan_role": log.fan,
        "sample_s": step_s,
        "effects": {"wall_loss": {"UA": {"fit": True}}, "extra_capacity": {"kC": {"fit": True}}},
        "sensor": {} if log.highest_c is None else {"highest_c": log.highest_c},
    }


def folder_name(log: RealLog) -> str:
    """Return the folder's name of a log's case and answer."""
    return log.name.replace(" ", "_").replace(",", "")


def is_true(log: RealLog, name: str) -> bool:
    """Return whether the rig is known to have the effect, or one that a log cannot tell from it."""
    return any(is_alike(name, own) for own in (*log.main, *log.true))


def _lines(log: RealLog, found: Mapping[str, Any], run: Mapping[str, Any]) -> list[str]:
    wrong = " FALSE" if log.main else " ?"  # no one knows what such a rig has
    names = [
        f"{item['name']} {item['probability']:.2f}{'' if is_true(log, item['name']) else wrong}"
        for item in found["effects"]
    ]
    tests = _tests(found)
    simple = {key: tests[key] for key in tests if key not in ("before", "after")}
    best = min(simple, key=lambda key: simple[key]) if simple else ""
    told = ", ".join(f"{key} {value:.3g}" for key, value in tests.items())
    offered = "offered" if found["twin_after"] else f"not offered: {'; '.join(found['against_adopting'])}"
    return [
        f"{log.name}: {found['verdict']}: {', '.join(names) or '-'}",
        f"    held out [K]: {told}; best simple: {best}",
        f"    {offered}; {run['cpu_s']:.0f} s of processor",
    ]


def _tests(found: Mapping[str, Any]) -> dict[str, float]:
    gaps = {key: found["gap"][key]["test"] for key in ("before", "after")}
    measured = {key: own["rmse_k"] for key, own in gaps.items() if own}
    return measured | {key: value for key, value in found["left_out"]["test_k"].items() if value is not None}


def _totals(found: Sequence[tuple[RealLog, Mapping[str, Any]]]) -> list[str]:
    known = [(log, own) for log, own in found if log.main]
    sure = [
        (is_true(log, item["name"]))
        for log, own in known
        for item in own["effects"]
        if item["probability"] >= SURE
    ]
    main = [
        any(
            is_alike(item["name"], name)
            for item in own["effects"]
            for name in log.main
            if item["probability"] >= SURE
        )
        for log, own in known
    ]
    near, worse = [], []
    for _, own in found:
        tests = _tests(own)
        # The best of the simple models in hindsight: harder to beat than any one of them.
        best = min(value for key, value in tests.items() if key not in ("before", "after"))
        near.append(tests["after"] <= 1.1 * best)
        worse.append(own["twin_after"] is not None and tests["after"] > best)
    return [
        f"main effect named with {SURE} or more: {sum(main)} of {len(main)}",
        f"names with {SURE} or more that are false: {sum(not own for own in sure)} of {len(sure)}",
        f"held out at most 1.10 of the best simple model: {sum(near)} of {len(near)}",
        f"offered and worse than the best simple model: {sum(worse)} of {len(worse)}",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
