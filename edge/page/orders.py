"""Which request of the control socket needs which role; what is not in the list is not passed on."""

from collections.abc import Mapping
from typing import Any

from edge.page.access import Role

NEEDS = {
    "emergency_stop": Role.VIEW,  # whoever sees that something is wrong may stop it
    "release_emergency_stop": Role.OPERATE,
    "clear_trip": Role.OPERATE,
    "maintenance": Role.OPERATE,
    "set_mode": Role.OPERATE,
    "set_fan_mode": Role.OPERATE,
    "set_reference": Role.OPERATE,
    "set_controller": Role.OPERATE,
    "set_manual": Role.OPERATE,
    "start_profile": Role.OPERATE,
    "pause_profile": Role.OPERATE,
    "resume_profile": Role.OPERATE,
    "skip_profile": Role.OPERATE,
    "end_profile": Role.OPERATE,
    "calibrate_point": Role.OPERATE,
    "discard_points": Role.OPERATE,
    "apply_calibration": Role.OPERATE,
    "reset_calibration": Role.OPERATE,
    "ask": Role.OPERATE,
    "proposal": Role.OPERATE,
    "confirm": Role.OPERATE,
    "discard": Role.OPERATE,
    "undo": Role.OPERATE,
    "memory": Role.OPERATE,
    "remember": Role.OPERATE,
    "forget": Role.OPERATE,
    "bundle": Role.ADMIN,
    "adopt": Role.ADMIN,
}


def problem(order: Mapping[str, Any], role: Role) -> str:
    """Return why a visitor of this role may not give an order, "" where they may."""
    kind = order.get("do")
    needed = NEEDS.get(kind) if isinstance(kind, str) else None
    if needed is None:
        return f"do: one of {', '.join(NEEDS)}"
    return "" if role >= needed else f"{kind} needs the role {needed.word}, yours is {role.word}"
