"""Runs stored as ingest stores the ticks of a rig that had them."""

import json
from dataclasses import replace

from edge.core.messages import Reading, ReadingQuality
from edge.formats.run_file import RecordedRun
from edge.formats.tick_json import tick_json
from fleet.ingest.tick import parse_tick
from fleet.numbers.series import lines
from fleet.numbers.victoria import Numbers
from tests.support.mqtt_rig import record

START = 1.79e9


def store(numbers: Numbers, rig: str, recorded: RecordedRun) -> None:
    """Store a run that begins at START, a tick a minute."""
    text = []
    for row in range(len(recorded)):
        air, room, duty, fan = (
            float(recorded.columns[name][row])
            for name in ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
        )
        readings = {
            name: Reading(name, value, 0.0, ReadingQuality.GOOD)
            for name, value in (("temp_air", air), ("temp_ambient", room))
        }
        made = record(row + 1, utc=START + 60.0 * row, readings=readings)
        assert made.echo is not None
        made = replace(made, echo=replace(made.echo, heater_duty=duty, fan_on=bool(fan)))
        payload = json.dumps({"history_id": "h", **tick_json(made)}).encode()
        tick = parse_tick(rig, payload, 0.0, made.utc)
        text.append(lines(rig, tick.utc, tick.samples))
    numbers.store("".join(text))
