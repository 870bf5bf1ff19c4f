"""`greenhouse what-if`: another heater, tighter walls, a weaker fan, by the twin that the daemon uses."""

import argparse
import json
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from edge.app.serving_twin import ServingTwin, serving_twin
from edge.app.what_if import Outlook, Quantity, TwinChange, WhatIf, other_walls, outlooks
from edge.app.what_if_words import HeatLimits, settings_in_the_way, span, unknowns_of, verdict
from edge.commands.arguments import number
from edge.commands.bundle import settings_of
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.core.hard_limits import TEMP_AIR_MAX_C
from edge.sockets.client import request
from edge.twin.new_file import HEATER_W

ROOM_C = (-20.0, 60.0)
WALL_MM, FACTOR = (0.1, 1000.0), (0.02, 50.0)
STATUS_MAX_S = 3.0
ROWS = (  # key of an outlook, in words, unit
    ("reach_c", "full heat for good", "°C"),
    ("warm_up_min", "to the target at full heat", "min"),
    ("power_w", "to hold the target", "W"),
    ("energy_kwh_day", "a day at the reference", "kWh"),
    ("fanned_c", "fan without heat", "°C"),
    ("cooling_min", "fan, from the target halfway to the room", "min"),
)
PACKAGED_NOTE = "This is the packaged twin, of the paper's box: `greenhouse commission` learns yours."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--heater-w", type=number(*HEATER_W), metavar="W", help="another heater's power")
    parser.add_argument(
        "--wall-factor",
        type=number(*FACTOR),
        metavar="TIMES",
        help="walls that conduct so many times as much; 0.5: twice as tight",
    )
    parser.add_argument(
        "--walls-mm", type=number(*WALL_MM), metavar="MM", help="walls of this thickness, same material"
    )
    parser.add_argument(
        "--wall", metavar="MATERIAL:MM", help="the present walls, for --walls-mm; like polycarbonate:8mm"
    )
    parser.add_argument(
        "--fan", type=number(0.0, 1.0), metavar="SHARE", help="a fan that moves this share of its air"
    )
    limits = number(-20.0, TEMP_AIR_MAX_C)
    parser.add_argument("--reach", type=limits, metavar="DEGC", help="target; default: the present reference")
    parser.add_argument("--hold", type=limits, metavar="DEGC", help="held all day; default: the reference")
    parser.add_argument(
        "--room", type=number(*ROOM_C), metavar="DEGC", help="room temperature; default: the present one"
    )
    parser.add_argument(
        "--from",
        dest="start",
        type=number(*ROOM_C),
        metavar="DEGC",
        help="air at the begin; default: the room's temperature",
    )
    parser.add_argument("--twin", type=Path, help="twin file; default: that of the active bundle")
    parser.add_argument("--config", type=Path, help="configuration file; default: the rig's")
    parser.add_argument("--json", action="store_true", help="print JSON, as the page reads it")


def run(arguments: argparse.Namespace) -> int:
    """Print the answer. Errors: RequestError, DataError"""
    settings = settings_of(arguments.config)
    twin = serving_twin(settings, arguments.twin)
    found = document(twin, _question(arguments, settings), HeatLimits.of(settings))
    print(json.dumps(found, allow_nan=False) if arguments.json else "\n".join(_lines(found)))
    return 0


def document(twin: ServingTwin, asked: WhatIf, limits: HeatLimits) -> dict[str, Any]:
    """Return the answer as JSON values: what is infinite is null. Errors: as `outlooks`"""
    now, changed = outlooks(twin.file, asked, limits.duty_max)
    rows = [(words, _cell(now, key, unit), _cell(changed, key, unit)) for key, words, unit in ROWS]
    found = changed or now
    return {
        "ok": True,
        "twin": twin.name,
        "question": asdict(asked),
        "verdict": verdict(asked, now, changed, limits),
        "limits": [*([] if twin.own else [PACKAGED_NOTE]), *settings_in_the_way(asked, found, limits)],
        "notes": list(unknowns_of(twin.file, asked, found)),
        "rows": [{"row": words, "now": one, "changed": other} for words, one, other in rows if one],
    }


def _cell(outlook: Outlook | None, key: str, unit: str) -> dict[str, Any] | None:
    quantity: Quantity | None = None if outlook is None else getattr(outlook, key)
    if quantity is None:
        return None
    ends = {name: value if math.isfinite(value) else None for name, value in asdict(quantity).items()}
    return {**ends, "text": span(quantity, unit)}


def _question(arguments: argparse.Namespace, settings: Settings) -> WhatIf:
    """Return the question; what is not said is that of the running rig. Errors: RequestError"""
    present = {} if None not in (arguments.room, arguments.reach) else _present(settings)
    reference_c = present.get("reference_c", settings.reference.reference_c)
    room_c = present.get("room_c", settings.control.ambient_default_c)
    room_c = room_c if arguments.room is None else arguments.room
    target_c = reference_c if arguments.reach is None else arguments.reach
    return WhatIf(
        TwinChange(arguments.heater_w, *_walls(arguments), arguments.fan),
        target_c,
        room_c,
        room_c if arguments.start is None else arguments.start,
        reference_c if arguments.hold is None else arguments.hold,
        time.time(),
    )


def _walls(arguments: argparse.Namespace) -> tuple[float | None, float]:
    """Return how many times as much they conduct, and as thick they are."""
    if arguments.walls_mm is None:
        return arguments.wall_factor, 1.0
    if arguments.wall_factor is not None:
        raise RequestError("--walls-mm and --wall-factor say the same in two ways: give one of them")
    if arguments.wall is None:
        raise RequestError(
            "--walls-mm needs the present walls, --wall polycarbonate:8mm; or give --wall-factor"
        )
    return other_walls(arguments.wall, arguments.walls_mm)


def _present(settings: Settings) -> dict[str, float]:
    """Return room and reference of the running daemon, nothing where none answers."""
    try:
        status = request(Path(settings.control_socket.path), {"do": "status"}, STATUS_MAX_S)
    except RequestError:
        return {}
    tick: Mapping[str, Any] = status.get("tick") or {}
    found = {"reference_c": tick.get("reference_c"), "room_c": tick.get("estimate", {}).get("temp_ambient_c")}
    return {name: float(value) for name, value in found.items() if isinstance(value, int | float)}


def _lines(found: Mapping[str, Any]) -> Iterator[str]:
    asked, rows = found["question"], found["rows"]
    yield found["verdict"]
    yield from found["limits"]
    yield ""
    yield (
        f"by {found['twin']}; room {asked['room_c']:g} °C, target {asked['target_c']:g} °C, "
        f"reference {asked['hold_c']:g} °C"
    )
    yield f"{'90 % intervals':<42}{'now':<20}{'with the change' if rows[0]['changed'] else ''}".rstrip()
    for row in rows:
        cells = [f"{cell['text']:<20}" for cell in (row["now"], row["changed"]) if cell]
        yield f"{row['row']:<42}{''.join(cells)}".rstrip()
    yield ""
    yield from found["notes"]
