"""Every byte of the live topics and of the control socket's answers, over an hour with faults and orders."""

import hashlib
import json
import re
from typing import Any

from loop_rig import LoopRig

from edge.core.messages import ReadingQuality
from edge.mqtt import states
from edge.tick.status import status_json

# Of the same script at commit 8465879, in which the control thread still encoded its answers itself; since
# then answers have the calibrations too.
SHA256 = "290b7ffa71de143bace493449faa2a5fc1b390614e8d8b00a8ad3b98139b9d68"
TOPICS = (states.decision, states.forecast, states.forecasts, states.skill, states.drift)
COUNTERS = {"ticks_late": 1, "ticks_skipped": 0, "outbox_depth": None}
STEERING = {
    "id": "a",
    "words": "wärmer",
    "until_utc": 1_750_004_000.0,
    "daily": [{"from_s": 0.0, "reference_c": 25.0}],
    "heater_penalty": 1.0,
    "fan_penalty": None,
    "heater_max_duty": 0.5,
    "fan_rest": [{"from_s": 0.0, "until_s": 60.0}],
}
ORDERS: tuple[dict[str, Any], ...] = (
    {"do": "status"},
    {"do": "set_reference", "reference_c": 27.5},
    {"do": "set_mode", "mode": "manual"},
    {"do": "set_manual", "heater_duty": 0.4},
    {"do": "emergency_stop"},
    {"do": "release_emergency_stop"},
    {"do": "steer", "steering": STEERING},
    {"do": "undo"},
    {"do": "maintenance", "minutes": 3},
    {"do": "maintenance", "minutes": 0},
    {"do": "clear_trip"},
    {"do": "nonsense"},
    {"do": "set_mode", "mode": "auto"},
)


def lived(rig: LoopRig) -> list[dict[str, Any]]:
    """All payloads in their order."""
    payloads = []
    for number in range(60):
        rig.board.temp_air = (22.0, 30.25, 51.0, None, 18.123456)[number // 7 % 5]
        rig.board.quality = list(ReadingQuality)[number // 11 % len(ReadingQuality)]
        rig.board.link_up, rig.board.confirms = number % 17 != 9, number % 13 != 4
        rig.board.tripped = number % 19 == 6
        rig.tick()
        status = status_json(rig.loop.status())
        payloads += [states.state(status, COUNTERS), *(topic(status) for topic in TOPICS)]
        payloads.append(rig.ask(ORDERS[number % len(ORDERS)]))
    return payloads


def test_the_payloads_are_the_same_to_the_byte() -> None:
    rig = LoopRig()
    lines = [json.dumps(each, separators=(",", ":"), allow_nan=False) for each in lived(rig)]
    rig.close()
    text = re.sub(r'"decide_ms":[0-9.]+', '"decide_ms":0', "\n".join(lines))  # how fast this machine is
    found = hashlib.sha256(text.encode()).hexdigest()
    assert found == SHA256, f"payloads have changed; where that is meant, SHA256 is {found}"
