"""Courses of one rig for a picture, asked of VictoriaMetrics: one question, all lines on one grid."""

import math

from fleet.numbers.series import selector
from fleet.numbers.victoria import Numbers
from fleet.settings import NumbersSettings

ANSWER_MAX_S = 10.0
POINTS_MAX = 2000
LEAST_STEP_S = 60.0  # a tick of most rigs
SPAN_MAX_S = 366 * 86_400.0
# Line of the picture -> its quantity, and the rollup over each step, "" for none. A bare series holds its
# value for about as long as a tick lasts, by VictoriaMetrics' own look at the distance between samples.
LINES = {
    "air_c": ("temp_air_c", ""),
    "air_low_c": ("temp_air_c", "min_over_time"),
    "air_high_c": ("temp_air_c", "max_over_time"),
    "reference_c": ("reference_c", ""),
    "room_c": ("estimate_temp_ambient_c", ""),
    "heater": ("echo_heater_duty", ""),
    "fan": ("echo_fan_share", ""),
}

Columns = dict[str, list[float | None]]


def course(
    settings: NumbersSettings, rig: str, first_utc: float, last_utc: float, points: int = 720
) -> Columns:
    """Return columns `utc` and those of LINES, [n]; None where nothing is known. Errors: NumbersError

    first_utc, last_utc : seconds since 1970; points : n at most
    """
    step_s = math.ceil(max(LEAST_STEP_S, (last_utc - first_utc) / min(max(points, 2), POINTS_MAX)))
    first = math.floor(first_utc / step_s) * step_s
    times = range(first, int(last_utc) + 1, step_s)
    columns: Columns = {"utc": [float(time) for time in times]}
    columns |= {line: [None] * len(times) for line in LINES}
    for series in Numbers(settings, ANSWER_MAX_S).query_range(_query(rig, step_s), first, last_utc, step_s):
        column = columns.get(series.labels.get("line", ""), [])
        for utc, value in zip(series.utc, series.values, strict=True):
            place = round((utc - first) / step_s)
            if 0 <= place < len(column):
                column[place] = value
    return columns


def _query(rig: str, step_s: int) -> str:
    def line(quantity: str, rollup: str) -> str:
        chosen = selector(quantity, rig=rig)
        return f"{rollup}({chosen}[{step_s}s])" if rollup else chosen

    parts = (f'label_set({line(*asked)}, "line", "{name}")' for name, asked in LINES.items())
    return f"union({', '.join(parts)})"
