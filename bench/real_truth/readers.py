"""How the texts of measured logs become columns of a run: one reader a format, shared where formats allow.

Times are from 0 in s, temperatures in degC, duties and fans 0..1.
"""

import ast
import csv
import io
import json
import pickle
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

from edge.core.errors import DataError

Floats = NDArray[np.float64]
Columns = dict[str, Floats]
Reader = Callable[[str], Columns]
MOST_ROWS = 3000
HOUSE_W = 2000.0
WORDS = {"True": 1.0, "False": 0.0, "": np.nan}
DAY_S = 86_400.0
HALL_FAN_KW, HALL_HEATS_KW = 2.4, 3.6  # of 6 kW, as its makers say


def finish(columns: Mapping[str, Floats], every: int = 1) -> Columns:
    """Return the rows that miss nothing, of equal times the last, from time 0.

    every : of so many rows the first is left, with the means of heater, fan and lamps over all of them
    """
    whole = np.all([np.isfinite(column) for column in columns.values()], axis=0)
    kept = {name: column[whole] for name, column in columns.items()}
    later = np.minimum.accumulate(np.append(kept["time_s"][1:], np.inf)[::-1])[::-1]
    kept = {name: column[kept["time_s"] < later] for name, column in kept.items()}
    rows = len(kept["time_s"]) // every * every
    thin = {
        name: column[:rows].reshape(-1, every).mean(1)
        if name in ("heater_duty", "fan_on", "led")
        else column[:rows:every]
        for name, column in kept.items()
    }
    return thin | {"time_s": thin["time_s"] - thin["time_s"][0]}


def unbroken(columns: Mapping[str, Floats], gap_s: float) -> Columns:
    """Return the longest stretch whose rows are at most so far apart, from time 0."""
    apart = np.diff(columns["time_s"])
    ends = np.flatnonzero((apart <= 0.0) | (apart > gap_s)) + 1
    stretch = {name: max(np.split(column, ends), key=len) for name, column in columns.items()}
    return stretch | {"time_s": stretch["time_s"] - stretch["time_s"][0]}


def _number(word: str) -> float:
    return WORDS[word] if word in WORDS else float(word)


def _time(word: str) -> float:
    return datetime.fromisoformat(word).replace(tzinfo=UTC).timestamp() if ":" in word else _number(word)


def _table(text: str, delimiter: str = ",") -> dict[str, list[str]]:
    rows = list(csv.reader(io.StringIO(text), delimiter=delimiter))
    return {name: [row[i] for row in rows[1:] if len(row) > i] for i, name in enumerate(rows[0])}


def pad(text: str) -> Columns:
    """Read a heating pad's console: times as hh:mm:ss, a heater that is ON or OFF, lines without readings."""
    found = _table(text)
    times = found["TimeElapsed"]
    duty = [{"ON": 1.0, "OFF": 0.0}.get(word, np.nan) for word in found["Heater"]]
    return finish(
        {
            "time_s": np.array([np.dot((3600, 60, 1), [*map(float, word.split(":"))]) for word in times]),
            "temp_air_c": np.array([float(word[:4]) for word in found["Temperature"]]),
            "heater_duty": np.array(duty),
        }
    )


def pizza_oven(text: str) -> Columns:
    """Read an oven's log, whose columns changed over the months, below two lines of settings."""
    found = _table(text[text.index("Index") :])
    column = {name.partition(" (")[0]: np.array([*map(float, words)]) for name, words in found.items()}
    room = column.get("Ambient temperature")
    air = column["Oven temperature" if "Oven temperature" in column else "Temperature"]
    duty = column["PWM controller" if "PWM controller" in column else "pwm_controller"]
    own = {"time_s": column["Time"] / 1000.0, "temp_air_c": air, "heater_duty": duty / 100.0}
    return finish(own if room is None else own | {"temp_ambient_c": room}, every=2)


def table(
    time: str, air: str, heat: str, *, tick_s: float = 1.0, full: float = 1.0, every: int = 1, **others: str
) -> Reader:
    """Read a table with heads; several columns of air, separated by blanks, are averaged.

    tick_s : unit of its times; full : heat at a duty of 1; others : our columns, and theirs (times a factor)
    """

    def read(text: str) -> Columns:
        words = _table(text)
        columns = {}
        for name, theirs in others.items():
            own, _, factor = theirs.partition("*")
            columns[name] = np.array([*map(_number, words[own])]) * float(factor or 1.0)
        columns["time_s"] = tick_s * np.array([*map(_time, words[time])])
        columns["temp_air_c"] = np.mean([[*map(_number, words[name])] for name in air.split()], axis=0)
        columns["heater_duty"] = np.clip(np.array([*map(_number, words[heat])]) / full, 0.0, 1.0)
        return finish(columns, every)

    return read


def plain(names: str, *, heads: int = 0, tick_s: float = 1.0, full: float = 1.0, every: int = 1) -> Reader:
    """Read numbers between blanks or commas below `heads` lines; of `names`, those of a run are kept."""

    def read(text: str) -> Columns:
        rows = _rows(text.replace(",", " "), heads)
        found = {name: rows[:, i] for i, name in enumerate(names.split()) if "_" in name}
        found["time_s"] = tick_s * found["time_s"]
        found["heater_duty"] = np.clip(found["heater_duty"] / full, 0.0, 1.0)
        return finish(found, every)

    return read


def _rows(text: str, heads: int) -> Floats:
    """Numbers between blanks, lines of another length left out."""
    lines = [line.split() for line in text.splitlines()[heads:] if line.strip()]
    return np.array([line for line in lines if len(line) == len(lines[0])], float)


def run_file(text: str) -> Columns:
    """One of ours, the first sensor and heater alone."""
    lines = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    words = _table(lines)
    return {name: np.array(words[name], float) for name in ("time_s", "temp_air_c", "heater_duty")}


def pwm_chamber(rows_a_second: float, every: int) -> Reader:
    """Sensor and PWM (0..255) without times: the recordings' names tell when each began, hence the pace."""

    def read(text: str) -> Columns:
        words = _table(text)
        temp, output = (np.array(words[name][::every], float) for name in ("si7021_c", "output"))
        most = min(len(temp), MOST_ROWS)
        times = np.arange(most) * every / rows_a_second
        return {"time_s": times, "temp_air_c": temp[:most], "heater_duty": output[:most] / 255.0}

    return read


def twin_house(living_c: int, living_w: int, outside_c: int) -> Reader:
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


def excited_kit(text: str) -> Columns:
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


def thermal_plant(text: str) -> Columns:
    """Read a TecQuipment plant: 10 rows a second, 1 V for 10 degC, the heater's drive of 0..10 V."""
    rows = _rows(text, 5)[::20]
    return {"time_s": rows[:, 0], "temp_air_c": 10.0 * rows[:, 1], "heater_duty": rows[:, 3] / 10.0}


def oven(text: str) -> Columns:
    """Set point, temperature and output in percent, four rows a second."""
    rows = _rows(text.replace(",", " "), 0)[::4]
    return {
        "time_s": np.arange(float(len(rows))),
        "temp_air_c": rows[:, 1],
        "heater_duty": np.clip(rows[:, 2] / 100.0, 0.0, 1.0),
    }


def lines(pattern: str, names: str, full: float = 1.0, every: int = 1) -> Reader:
    """Read what a pattern finds in each line of a console."""
    told = re.compile(pattern, re.MULTILINE)

    def read(text: str) -> Columns:
        found = np.array(told.findall(text), float)
        columns = dict(zip(names.split(), found.T, strict=True))
        return finish(columns | {"heater_duty": columns["heater_duty"] / full}, every)

    return read


def klipper(heater: str, every: int) -> Reader:
    """Read the longest unbroken stretch of Klipper's own log, a line a second with the last of its duties."""
    told = re.compile(rf"^Stats ([\d.]+): .*\b{heater}: target=\S+ temp=(\S+) pwm=(\S+)", re.MULTILINE)

    def read(text: str) -> Columns:
        rows = np.array(told.findall(text), float)
        columns = dict(zip(("time_s", "temp_air_c", "heater_duty"), rows.T, strict=True))
        return finish(unbroken(columns, gap_s=10.0), every)

    return read


def fan_calibration(text: str) -> Columns:
    """Read a hot end's calibration: samples, when its heater was switched, and where a fan starts."""
    words = [line.split() for line in text.splitlines()]
    samples = np.array([row for row in words if row[0] not in ("pwm:", "phase")], float)
    switched = np.array([row[1:] for row in words if row[0] == "pwm:"], float)
    starts = next(int(row[3]) for row in words if row[:2] == ["phase", "heatup_fan"])
    now = np.searchsorted(switched[:, 0], samples[:, 0], side="right")
    return finish(
        {
            "time_s": samples[:, 0],
            "temp_air_c": samples[:, 1],
            "heater_duty": np.concatenate([[0.0], switched[:, 1]])[now],
            "fan_on": np.where(np.arange(len(samples)) < starts, 0.0, 1.0),
        },
        every=3,
    )


def triacs(text: str) -> Columns:
    """Messages of a reflow oven: temperature in hundredths, percents of two elements, which hold."""
    duty = {769: 0.0, 770: 0.0}
    rows = []
    for said in map(json.loads, filter(None, text.splitlines())):
        if said["cmd"] in duty:
            duty[said["cmd"]] = said["arg"] / 100.0
        elif said["cmd"] == 257:
            rows.append((said["t"] / 1000.0, said["arg"] / 100.0, sum(duty.values()) / len(duty)))
    return finish(dict(zip(("time_s", "temp_air_c", "heater_duty"), np.array(rows).T, strict=True)))


def roaster(text: str) -> Columns:
    """Artisan's log of a roast: the beans' sensor and the burner, whose events hold; 1 is 0, 11 is full."""
    found = ast.literal_eval(text)
    time, air = np.array(found["timex"]), np.array(found["temp2"], float)
    duty = np.zeros(len(time))
    events = zip(found["specialevents"], found["specialeventstype"], found["specialeventsvalue"], strict=True)
    for index, kind, value in sorted(events):
        if kind == 3:
            duty[index:] = np.clip((value - 1.0) / 10.0, 0.0, 1.0)
    missing = air == -1.0
    return finish({"time_s": time, "temp_air_c": np.where(missing, np.nan, air), "heater_duty": duty})


def dryer(text: str) -> Columns:
    """Read a filament dryer: a tag a line, columns by its header; the heater is on or off."""
    rows = [line.split("\t") for line in text.splitlines()]
    names = next(row for row in rows if row[1:2] == ["SENSORS_HEADER"])[2:]
    values = np.array([row[:1] + row[2:] for row in rows if row[1:2] == ["SENSORS_VALUES"]], float)
    own = dict(zip(names, values[:, 1:].T, strict=True))
    return finish(
        {
            "time_s": values[:, 0] / 1000.0,
            "temp_air_c": own["silicagel_C"],
            "temp_ambient_c": own["ext_C"],
            "heater_duty": (own["heater_heater"] > 0.0) * 1.0,
            "fan_on": own["silicagel_Fan"],
        }
    )


def _matlab(text: str, key: str) -> Any:
    return loadmat(io.BytesIO(text.encode("utf-8", "surrogateescape")))[key]


def heat_shield(text: str) -> Columns:
    """Temperature and percent, two seconds a row."""
    rows = _matlab(text, "resultID")
    return finish(
        {
            "time_s": np.arange(0.0, 2.0 * len(rows), 2.0),
            "temp_air_c": rows[:, 0],
            "heater_duty": np.clip(rows[:, 1] / 100.0, 0.0, 1.0),
        },
        every=2,
    )


def air_duct(text: str) -> Columns:
    """Read a lab's duct, 100 rows a second, the heater's drive of 0..10 V."""
    time_s, air, heat = (_matlab(text, name).ravel() for name in ("Zeit", "Temperatur", "Heizung"))
    return finish({"time_s": time_s, "temp_air_c": air, "heater_duty": heat / 10.0}, every=10)


def greenhouse(text: str) -> Columns:
    """Read Wageningen's crops under lamps: columns by the makers' order, five minutes a row."""
    rows = _matlab(text, "septemberiotdatasetstestmaturecrops").T
    order = {"time_s": 0, "temp_air_c": 3, "temp_ambient_c": 4, "heater_duty": 11, "fan_on": 10, "led": 9}
    return finish({name: rows[i] for name, i in order.items()} | {"solar_w_m2": rows[1]})


def hall(text: str) -> Columns:
    """EPFL's Polydome: the heat pump's electric power [kW], negative when it heats, over that of its fan."""
    struct = _matlab(text, "exp")[0, 0]
    numbers = [name for name in struct.dtype.names if struct[name].dtype.kind in "fui"]
    own = {name: struct[name].astype(np.float64).ravel() for name in numbers}
    columns = {
        "time_s": DAY_S * own["time"],
        "temp_air_c": sum(own[f"sensor_temp_{i}"] for i in range(1, 5)) / 4.0,
        "temp_ambient_c": own["weather_temp"],
        "heater_duty": np.clip((-own["power"] - HALL_FAN_KW) / HALL_HEATS_KW, 0.0, 1.0),
        "solar_w_m2": own["weather_rad"],
    }
    return unbroken(finish(columns), gap_s=DAY_S / 4.0)
