"""Short ways to say what the safety supervisor sees."""

import math
from typing import Any

from edge.config.settings import SafetySettings
from edge.core.messages import Change, Command, Echo, Estimate, Reading, ReadingQuality
from edge.safety.supervisor import SafetyMemory, SafetyVerdict, SafetyView, supervise

NOW = 1000.0
UTC = 1.7e9
NOT_NUMBERS = (None, math.nan, math.inf, -math.inf)
FULL = Command(heater_duty=1.0, fan_on=False, led=1.0, valve_pulse_s=2.0)


def reading(
    signal: str, value: float | None, age_s: float = 0.0, quality: ReadingQuality = ReadingQuality.GOOD
) -> Reading:
    return Reading(signal, value, NOW - age_s, quality)


def echo(duty: float = 0.0, fan: bool = False, cause: str = "") -> Echo:
    return Echo(duty, fan, 0.0, False, bool(cause), cause, NOW)


def view(
    air: float | Reading | None = 25.0,
    soil: float | Reading | None = 0.2,
    tank: float | Reading | None = 0.9,
    room: float | Reading | None = 21.0,
    **changed: Any,
) -> SafetyView:
    """A warm, dry, healthy box at NOW; a bare number is a fresh good reading."""
    values = {"temp_air": air, "soil_moisture": soil, "tank_level": tank, "temp_ambient": room}
    given: dict[str, Any] = {
        "readings": {
            name: value if isinstance(value, Reading) else reading(name, value)
            for name, value in values.items()
        },
        "estimate": Estimate(25.0, 0.1, 0.0, 0.0, 21.0, NOW),
        "echo": echo(),
        "link_up": True,
        "emergency_stop": False,
        "maintenance": False,
        "now_s": NOW,
        "utc": UTC,
        "dt_s": 60.0,
    }
    return SafetyView(**given | changed)


def judge(
    wanted: Command = FULL,
    seen: SafetyView | None = None,
    memory: SafetyMemory | None = None,
    **settings: float,
) -> SafetyVerdict:
    return supervise(wanted, seen or view(), memory or SafetyMemory(), SafetySettings(**settings))


def rules(verdict: SafetyVerdict, actuator: str) -> list[str]:
    return [change.rule for change in verdict.changes if change.actuator == actuator]


def only_change(verdict: SafetyVerdict, actuator: str) -> Change:
    (change,) = (change for change in verdict.changes if change.actuator == actuator)
    return change
