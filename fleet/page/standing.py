"""The standing of a rig, from what it has told last: the worst thing that is so, and why."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from fleet.database.tables import SILENT_S

OFF_REFERENCE_K = 1.0  # a rig at rest stays within a tenth of it


class Standing(IntEnum):
    """The worst first."""

    OFFLINE = 0
    TRIPPED = 1
    FAULTED = 2
    STOPPED = 3
    OFF_REFERENCE = 4
    DRIFT = 5
    WELL = 6

    @property
    def word(self) -> str:
        """Return it as it stands in the API."""
        return self.name.lower()


STANDINGS = {standing.word: standing for standing in Standing}


@dataclass(frozen=True, slots=True)
class RigFinding:
    """A rig's standing and the reason as a sentence, "" where it is well."""

    standing: Standing
    why: str = ""


def find(
    state: Mapping[str, Any], drift: Mapping[str, Any], is_online: bool, last_utc: float, now_utc: float
) -> RigFinding:
    """Return the worst that is so.

    state, drift : the newest payloads of the rig's topics of these names, {} before the first
    last_utc : when the rig was heard last, 0 for never; now_utc : both in seconds since 1970
    """
    silent_s = now_utc - last_utc
    if not last_utc:
        return RigFinding(Standing.OFFLINE, "never heard yet")
    if not is_online or not silent_s < SILENT_S:
        return RigFinding(Standing.OFFLINE, f"last heard {_age(silent_s)} ago")
    if state.get("tripped"):
        return RigFinding(Standing.TRIPPED, f"tripped: {state.get('trips') or 'no cause given'}")
    if fault := _fault(state):
        return RigFinding(Standing.FAULTED, fault)
    if state.get("emergency_stop"):
        return RigFinding(Standing.STOPPED, "emergency stop: everything stays off until it is released")
    if state.get("maintenance"):
        return RigFinding(Standing.STOPPED, "in maintenance: everything is off")
    off_k = _off_reference(state)
    if off_k is not None and not abs(off_k) <= OFF_REFERENCE_K:
        return RigFinding(Standing.OFF_REFERENCE, f"air is {off_k:+.1f} K off its reference")
    if drift.get("state") == "disagrees":
        return RigFinding(Standing.DRIFT, str(drift.get("text") or "its twin disagrees with the greenhouse"))
    return RigFinding(Standing.WELL)


def number_of(values: Mapping[str, Any], key: str) -> float | None:
    """Return a number of a payload, None where there is none."""
    value = values.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _fault(state: Mapping[str, Any]) -> str:
    if not state:
        return "online, but it has not told its state yet"
    if state.get("link_up") is not None and not state["link_up"]:
        return "its board is silent"
    if number_of(state, "temp_air_c") is None:
        return f"no trustworthy air temperature: {state.get('temp_air_quality') or 'absent'}"
    return "its daemon reports a problem" if state.get("problem") else ""


def _off_reference(state: Mapping[str, Any]) -> float | None:
    """Return air minus reference [K]; None while nothing holds a reference."""
    air, reference = number_of(state, "temp_air_c"), number_of(state, "reference_c")
    is_held = state.get("mode") not in ("off", "fan_only", "manual")
    return None if air is None or reference is None or not is_held else air - reference


def _age(seconds: float) -> str:
    for unit, size in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(seconds, 0.0):.0f} s"
