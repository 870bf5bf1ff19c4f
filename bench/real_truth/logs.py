"""Which measured logs, where they are, how their columns are read, and what is known of the truth.

Half of them are for development, half for scoring: the split was made before any scoring log was looked at,
and none moves back. Commits are those at which the paths were seen.

For scoring, once, when the engine is frozen, and so not read yet: rawlings-group/mlid_2024 @9f1c939 (tclab
pickles), Subve/System-identification @e96d6c5 (heating_system), RonakornST/EE436_Lab_Control @5c98e6d,
BaltazarUach/Solar-Greenhouse-Dryer @8f2cb19 (Datos.xlsx), pkrysztopa/HVAC-equipment-fault-detection @94166e3,
czagoni/darkgreybox @280a7cd, locie/pySIP @da70d25 (armadillo), cellularmitosis/logs @31b3970 (20180114-*),
and open-ideas/IDEAS @272d82a (O5Exp1 and Exp2).
"""

import csv
import io
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import DataError

Floats = NDArray[np.float64]
Columns = dict[str, Floats]
SHARED = "shared"  # logs that lie beside the checkout, see README.md
HEATER_LIKE = ("heater_lag", "sensor_lag", "heater_deadtime", "imperfect_mixing")
BODY_LIKE = ("soil_mass", "wall_mass")


@dataclass(frozen=True, slots=True)
class RealLog:
    """source : repository, or SHARED; commit : of it; paths : within it

    read : text of a file to columns of one recording
    volume_m3, heater_w : what its owner could know; step_s : of the twin
    main : any of these names the effect that the log shows most; true : others that are there too
    whole : recordings train or test as wholes, the last third tests; else each is divided in time
    """

    name: str
    split: str
    source: str
    commit: str
    paths: tuple[str, ...]
    read: Callable[[str], Columns]
    volume_m3: float
    heater_w: float
    step_s: float
    main: tuple[str, ...]
    true: tuple[str, ...] = ()
    fan: str = "none"
    whole: bool = False
    note: str = ""


def texts(log: RealLog, data: Path, repositories: Path) -> list[str]:
    """Its files. Errors: DataError that says where to get them"""
    if log.source == SHARED:
        found = [path for pattern in log.paths for path in sorted(data.glob(pattern))]
        if not found:
            raise DataError(f"{data}: holds no {', '.join(log.paths)}: --data says where the logs lie")
        return [path.read_text(encoding="utf-8") for path in found]
    return [_shown(log, path, repositories) for path in log.paths]


def _shown(log: RealLog, path: str, repositories: Path) -> str:
    """A file at the log's commit, from a clone called `name`, or a bare one called `owner+name/repo`."""
    owner, _, name = log.source.partition("/")
    for place in (repositories / f"{owner}+{name}" / "repo", repositories / name / ".git"):
        if place.exists():
            command = ["git", f"--git-dir={place}", "show", f"{log.commit}:{path}"]
            found = subprocess.run(command, capture_output=True, check=False)
            if found.returncode:
                raise DataError(f"{place}: {log.commit}:{path}: {found.stderr.decode().strip()}")
            return found.stdout.decode("utf-8")
    raise DataError(f"{repositories}: no clone of https://github.com/{log.source}: git clone it there")


def _table(text: str, delimiter: str = ",") -> dict[str, list[str]]:
    rows = list(csv.reader(io.StringIO(text), delimiter=delimiter))
    return {name: [row[i] for row in rows[1:] if len(row) > i] for i, name in enumerate(rows[0])}


def _run_file(text: str) -> Columns:
    """One of ours, the first sensor and heater alone."""
    lines = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    table = _table(lines)
    return {name: np.array(table[name], float) for name in ("time_s", "temp_air_c", "heater_duty")}


def _lab_kit(text: str) -> Columns:
    """Temperature Control Lab as its course stores it: two rows at time 0, the heater in percent."""
    table = {name: np.array(table_column, float) for name, table_column in _table(text).items()}
    later = np.concatenate([np.diff(table["Time"]) > 0.0, [True]])
    return {
        "time_s": table["Time"][later],
        "temp_air_c": table["T1"][later],
        "heater_duty": table["Q1"][later] / 100.0,
    }


def _pwm_chamber(rows_a_second: float, every: int) -> Callable[[str], Columns]:
    """Sensor and PWM (0..255) without times: the recordings' names tell when each began, hence the pace."""

    def read(text: str) -> Columns:
        table = _table(text)
        temp, output = (np.array(table[name][::every], float) for name in ("si7021_c", "output"))
        most = min(len(temp), MOST_ROWS)
        times = np.arange(most) * every / rows_a_second
        return {"time_s": times, "temp_air_c": temp[:most], "heater_duty": output[:most] / 255.0}

    return read


MOST_ROWS = 3000
LIVING_C, LIVING_W, OUTSIDE_C = 5, 19, 35  # columns of the Twin Houses' tables, from ValidationDataN2Exp1.mo
HOUSE_W = 2000.0


def _twin_house(text: str) -> Columns:
    """The living room, ten minutes a row, its electric heater metered."""
    rows = np.array([line.split() for line in text.splitlines()[2:] if line.strip()], float)
    return {
        "time_s": rows[:, 0] - rows[0, 0],
        "temp_air_c": rows[:, LIVING_C],
        "temp_ambient_c": rows[:, OUTSIDE_C],
        "heater_duty": np.clip(rows[:, LIVING_W] / HOUSE_W, 0.0, 1.0),
    }


def _kit(name: str, path: str) -> RealLog:
    return RealLog(
        f"lab kit, {name}", "dev", SHARED, "", (path,), _run_file, 1e-4, 3.6, 3.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), note="transistor, sink and thermistor; no air in a box",
    )  # fmt: skip


LOGS: Sequence[RealLog] = (
    RealLog(
        "plywood box, each divided", "dev", SHARED, "", ("heated_box/*.csv",), _run_file, 0.03, 42.0, 5.0,
        HEATER_LIKE, BODY_LIKE, note="the heating plate's own temperature was measured: it lags by a minute",
    ),
    RealLog(
        "plywood box, by date", "dev", SHARED, "", ("heated_box/*.csv",), _run_file, 0.03, 42.0, 5.0,
        HEATER_LIKE, BODY_LIKE, whole=True,
    ),
    _kit("energy balance", "tclab/energy_balance.csv"),
    _kit("second order", "tclab/second_order.csv"),
    _kit("hybrid", "tclab/hybrid.csv"),
    RealLog(
        "lab kit, another", "dev", "jckantor/CBE30338", "9341811",
        ("notebooks/data/0B.99-Step_Test_Data.csv",),
        _lab_kit, 1e-4, 3.6, 3.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
    ),
    RealLog(
        "25 degC chamber, run 3", "dev", "cellularmitosis/logs", "31b3970",
        ("20180124-25c-chamber/1516867509-run3/out.csv",), _pwm_chamber(3.28, 16), 0.02, 10.0, 5.0,
        HEATER_LIKE, BODY_LIKE, note="bang-bang, the room not measured",
    ),
    RealLog(
        "25 degC chamber, run 5", "dev", "cellularmitosis/logs", "31b3970",
        ("20180124-25c-chamber/1516946844-run5/out.csv",), _pwm_chamber(3.28, 16), 0.02, 10.0, 5.0,
        HEATER_LIKE, BODY_LIKE,
    ),
    RealLog(
        "Twin House N2, living room", "dev", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataN2Exp1.txt",), _twin_house, 83.0, HOUSE_W, 600.0,
        BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
)  # fmt: skip
