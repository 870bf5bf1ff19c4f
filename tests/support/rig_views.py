"""Views of a rig as the page has them, made up."""

from typing import Any


def view(
    reached: bool = True, silent_s: float | None = 0.0, waits: Any = None, **status: Any
) -> dict[str, Any]:
    tick = {"seq": 5, "step_s": 60.0, "readings": {"temp_air_c": {"value": 24.0, "quality": "good"}}}
    known = {
        "operation": {"emergency_stop": False},
        "since_start_s": 1e5,
        "trips": [],
        "tick": tick,
        "echo": {"tripped": 0, "trip_cause": ""},
        "link_up": 1,
        "conditions": {},
    } | status
    return {
        "reached": reached,
        "error": "" if reached else "no daemon listens at /run/x",
        "silent_s": silent_s,
        "lease_s": 10.0,
        "stop_waits": waits,
        "status": known if reached or silent_s is not None else None,
    }
