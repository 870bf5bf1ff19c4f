"""Courses of one rig for a picture, asked of VictoriaMetrics: one question, all lines on one grid."""

import json
import math
from typing import Any

import requests

from edge.core.errors import DataError
from fleet.settings import NumbersSettings

ANSWER_MAX_S = 10.0
POINTS_MAX = 2000
LEAST_STEP_S = 60.0  # a tick of most rigs
SPAN_MAX_S = 366 * 86_400.0
# Line of the picture -> query. A bare series holds its value for about as long as a tick lasts, by
# VictoriaMetrics' own look at the distance between samples.
LINES = {
    "air_c": "greenhouse_temp_air_c{%s}",
    "air_low_c": "min_over_time(greenhouse_temp_air_c{%s}[%ds])",
    "air_high_c": "max_over_time(greenhouse_temp_air_c{%s}[%ds])",
    "reference_c": "greenhouse_reference_c{%s}",
    "room_c": "greenhouse_estimate_temp_ambient_c{%s}",
    "heater": "greenhouse_echo_heater_duty{%s}",
    "fan": "greenhouse_echo_fan_share{%s}",
}

Columns = dict[str, list[float | None]]


def course(
    settings: NumbersSettings, rig: str, first_utc: float, last_utc: float, points: int = 720
) -> Columns:
    """Return columns `utc` and those of LINES, [n]; None where nothing is known. Errors: DataError

    first_utc, last_utc : seconds since 1970; points : n at most
    """
    step_s = math.ceil(max(LEAST_STEP_S, (last_utc - first_utc) / min(max(points, 2), POINTS_MAX)))
    first = math.floor(first_utc / step_s) * step_s
    asked = {"query": _query(rig, step_s), "start": first, "end": last_utc, "step": step_s, "nocache": 1}
    times = range(first, int(last_utc) + 1, step_s)
    columns: Columns = {"utc": [float(time) for time in times]}
    columns |= {line: [None] * len(times) for line in LINES}
    for series in _ask(settings, asked):
        column = columns.get(series["metric"].get("line", ""))
        for utc, value in series["values"] if column is not None else ():
            place = round((utc - first) / step_s)
            if column is not None and 0 <= place < len(column):
                column[place] = float(value)
    return columns


def _query(rig: str, step_s: int) -> str:
    # JSON's quotes are PromQL's, so no name of a rig can end the text that it stands in.
    chosen = f"rig={json.dumps(rig, ensure_ascii=False)}"
    parts = (
        f'label_set({query.replace("%s", chosen).replace("%d", str(step_s))}, "line", "{line}")'
        for line, query in LINES.items()
    )
    return f"union({', '.join(parts)})"


def _ask(settings: NumbersSettings, asked: dict[str, Any]) -> list[Any]:
    try:
        answer = requests.post(f"{settings.url}/api/v1/query_range", data=asked, timeout=ANSWER_MAX_S)
        found = answer.json()
    except (requests.RequestException, ValueError) as error:
        raise DataError(
            f"numbers.url: {settings.url}: {type(error).__name__}: no course can be read"
        ) from None
    if found.get("status") != "success":
        raise DataError(f"numbers.url: {settings.url}: {found.get('error') or answer.status_code}")
    return list(found["data"]["result"])
