"""Which measured logs, where they are, how their columns are read, and what is known of the truth.

Half of them are for development, half for scoring: the split was made before any scoring log was looked at,
and none moves back. Commits are those at which the paths were seen.

Left out as no heater's power or duty is in them: BaltazarUach/Solar-Greenhouse-Dryer @8f2cb19 (sun alone) and
pkrysztopa/HVAC-equipment-fault-detection @94166e3 (air handling units).
"""

import csv
import io
import pickle
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError

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
    highest_c: float | None = None


def texts(log: RealLog, data: Path, repositories: Path) -> list[str]:
    """Its files. Errors: DataError that says where to get them"""
    if log.source == SHARED:
        found = [path for pattern in log.paths for path in sorted(data.glob(pattern))]
        if not found:
            raise DataError(f"{data}: holds no {', '.join(log.paths)}: --data says where the logs lie")
        return [path.read_text(encoding="utf-8") for path in found]
    return [_show(log, path, repositories) for path in log.paths]


def _show(log: RealLog, path: str, repositories: Path) -> str:
    """Return a file at the log's commit, from a clone called `name`, or a
    bare one called `owner+name/repo`.
    """
    owner, _, name = log.source.partition("/")
    for place in (repositories / f"{owner}+{name}" / "repo", repositories / name / ".git"):
        if place.exists():
            command = ["git", f"--git-dir={place}", "show", f"{log.commit}:{path}"]
            found = subprocess.run(command, capture_output=True, check=False)
            if found.returncode:
                raise DataError(f"{place}: {log.commit}:{path}: {found.stderr.decode().strip()}")
            return found.stdout.decode("utf-8", "surrogateescape")
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
HOUSE_W = 2000.0


def _twin_house(living_c: int, living_w: int, outside_c: int) -> Callable[[str], Columns]:
    """Read the living room, ten minutes a row, its electric heater metered;
    columns from ValidationData*.mo.
    """

    def read(text: str) -> Columns:
        rows = _rows(text, 2)
        return {
            "time_s": rows[:, 0] - rows[0, 0],
            "temp_air_c": rows[:, living_c],
            "temp_ambient_c": rows[:, outside_c],
            "heater_duty": np.clip(rows[:, living_w] / HOUSE_W, 0.0, 1.0),
        }

    return read


def _rows(text: str, heads: int) -> Floats:
    """Numbers between blanks, lines of another length left out."""
    lines = [line.split() for line in text.splitlines()[heads:] if line.strip()]
    return np.array([line for line in lines if len(line) == len(lines[0])], float)


class _Arrays(pickle.Unpickler):
    """A pickle of strangers, of which only numpy arrays are read."""

    def find_class(self, module: str, name: str) -> Any:
        """Errors: DataError for anything that could run."""
        if (module, name) == ("numpy", "dtype"):
            return np.dtype
        if name == "_frombuffer":
            return lambda buffer, dtype, shape, order: np.frombuffer(buffer, dtype).reshape(
                shape, order=order
            )
        raise DataError(f"a pickle that asks for {module}.{name}")


def _excited_kit(text: str) -> Columns:
    """Temperature Control Lab, both heaters (percent) moving by themselves; the first one and its sensor.

    Of several experiments in a file the first.
    """
    found = _Arrays(io.BytesIO(text.encode("utf-8", "surrogateescape"))).load()
    found = found if "t" in found else next(iter(found.values()))
    every = slice(None, None, 3)
    return {
        "time_s": found["t"].astype(np.float64)[every],
        "temp_air_c": found["y"][0][every],
        "heater_duty": found["u"][0][every] / 100.0,
    }


def _lamp(text: str) -> Columns:
    """DaISy's heating system: drive of a lamp (0..10 V) and a plate's back."""
    rows = _rows(text, 0)
    return {"time_s": rows[:, 0], "temp_air_c": rows[:, 2], "heater_duty": rows[:, 1] / 10.0}


def _thermal_plant(text: str) -> Columns:
    """Read a TecQuipment plant: 10 rows a second, 1 V for 10 degC, the heater's drive of 0..10 V."""
    rows = _rows(text, 5)[::20]
    return {"time_s": rows[:, 0], "temp_air_c": 10.0 * rows[:, 1], "heater_duty": rows[:, 3] / 10.0}


def _oven(text: str) -> Columns:
    """Set point, temperature and output in percent, four rows a second."""
    rows = _rows(text.replace(",", " "), 0)[::4]
    return {
        "time_s": np.arange(float(len(rows))),
        "temp_air_c": rows[:, 1],
        "heater_duty": np.clip(rows[:, 2] / 100.0, 0.0, 1.0),
    }


def _house(
    time: str, air: str, outside: str, heat: str, full: float, step_s: float, sun: str = ""
) -> Callable[[str], Columns]:
    """Read a table with heating power, `full` at most, rows a `step_s` apart."""

    def read(text: str) -> Columns:
        table = _table(text)
        named = {"temp_air_c": air, "temp_ambient_c": outside, "heater_duty": heat}
        named |= {"solar_w_m2": sun} if sun else {}
        found = {name: np.array(table[column], float) for name, column in named.items()}
        rows = len(table[time])
        return {**found, "time_s": step_s * np.arange(rows), "heater_duty": found["heater_duty"] / full}

    return read


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
        ("IDEAS/Resources/measurements/validationdataN2Exp1.txt",), _twin_house(5, 19, 35), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "lab kit, excited", "scored", "rawlings-group/mlid_2024", "9f1c939", ("data/tclab_prbs.pickle",),
        _excited_kit, 1e-4, 3.6, 3.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
        note="a second heater beside it moves too, and nobody says so",
    ),
    RealLog(
        "lab kit, closed loop", "scored", "rawlings-group/mlid_2024", "9f1c939",
        ("data/tclab_cl_dist.pickle",),
        _excited_kit, 1e-4, 3.6, 3.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
        note="power and sensor were disturbed on purpose",
    ),
    RealLog(
        "lamp over a plate", "scored", "Subve/System-identification", "e96d6c5", ("heating_system.dat",),
        _lamp, 1e-3, 300.0, 2.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"), highest_c=400.0,
    ),
    RealLog(
        "thermal plant", "scored", "RonakornST/EE436_Lab_Control", "5c98e6d",
        ("P1/data_thermal_labp1_setpoint.txt",), _thermal_plant, 1e-3, 20.0, 2.0, HEATER_LIKE, BODY_LIKE,
        highest_c=100.0,
    ),
    RealLog(
        "Peltier oven", "scored", "cellularmitosis/logs", "31b3970",
        tuple(
            f"20180114-pid-oven-tuning/run{name}-250ms.csv"
            for name in (
                "10-p5.0-i0.0-d0.0", "11-p5.0-i0.0-d1.0", "12-p5.0-i0.0-d2.0", "13-p8.0-i0.0-d1.0",
            )
        ),
        _oven, 1e-3, 30.0, 1.0, HEATER_LIKE, BODY_LIKE, whole=True,
    ),
    RealLog(
        "Twin House O5, living room", "scored", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataO5Exp1.txt",), _twin_house(5, 19, 35), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "Twin House, second experiment", "scored", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataExp2.txt",), _twin_house(6, 27, 53), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "building with several zones", "scored", "czagoni/darkgreybox", "280a7cd",
        ("docs/tutorials/data/demo_data.csv",), _house("", "Ti", "Ta", "Ph", 160.0, 3600.0), 5000.0,
        160_000.0, 3600.0, (*BODY_LIKE, *HEATER_LIKE),
    ),
    RealLog(
        "house in winter", "scored", "locie/pySIP", "da70d25", ("data/armadillo/armadillo_data_H2.csv",),
        _house("Time", "T_int", "T_ext", "P_hea", 2500.0, 1800.0, "I_sol"), 125.0, 2500.0, 1800.0, BODY_LIKE,
        ("solar_gain", "constant_heat"),
    ),
)  # fmt: skip
