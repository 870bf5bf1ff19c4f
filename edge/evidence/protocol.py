"""The 30-day protocol in numbers: thresholds and provoked faults, fixed before any rig has run.

The start of each record holds the digest of these numbers, so a report by other numbers is refused. The table
in docs/hardware/protocol.md is made from this file.
"""

import hashlib
import json
from dataclasses import asdict, dataclass

DAYS = 30  # whole UTC days after the day of the start
DAY_SHARE = 0.95  # of a day's ticks; a day with fewer counts as a day without data
REPEATS = 3  # of each provoked fault
FORECASTER, HORIZON_MIN = "pbm", 30  # the twin's own forecast, as far ahead as it plans
NEAR_K = 1.0
STEP_TEST, REFERENCE_1, REFERENCE_2, HANDS = "step_test", "reference_1", "reference_2", "hands"


@dataclass(frozen=True, slots=True)
class ProvokedFault:
    """A fault that a person provokes.

    keys : events of which any names it; within_min : the longest allowed time from mark to event [min]
    """

    name: str
    how: str
    keys: tuple[str, ...]
    within_min: float


FAULTS = (
    ProvokedFault(
        "sensor_unplugged",
        "unplug all air sensors for 10 minutes, heater on",
        ("reading.not_good",),
        3.0,
    ),
    ProvokedFault(
        "usb_pulled",
        "pull the board's USB cable for 10 minutes",
        ("board.unplugged", "board.link_lost", "board.link_down"),
        2.0,
    ),
    ProvokedFault(
        "power_cut",
        "cut the power of computer and board for 5 minutes",
        ("history.unclean_stop", "history.numbers_left_out"),
        15.0,
    ),
    ProvokedFault(
        "heater_supply_cut",
        "switch the heater's supply off while heat is needed",
        ("safety.heater_no_effect",),
        45.0,
    ),
    ProvokedFault(
        "fan_blocked", "cover the fan's opening while cooling is asked for", ("safety.fan_no_effect",), 30.0
    ),
)
PHASES = (STEP_TEST, REFERENCE_1, REFERENCE_2, HANDS, *(fault.name for fault in FAULTS))


@dataclass(frozen=True, slots=True)
class Threshold:
    """One criterion. at_least : the value must reach the limit, else it must not exceed it"""

    key: str
    text: str
    limit: float
    unit: str
    at_least: bool = False

    def passes(self, value: float) -> bool:
        """Return whether the value meets the limit; a value that is not a number does not."""
        return value >= self.limit if self.at_least else value <= self.limit

    @property
    def rule(self) -> str:
        """The limit in words."""
        return f"at {'least' if self.at_least else 'most'} {self.limit:g} {self.unit}".strip()


THRESHOLDS = (
    Threshold("days", f"days with at least {DAY_SHARE:.0%} of their ticks, of {DAYS}", 27.0, "days", True),
    Threshold("lost", "ticks lost outside provoked faults", 0.5, "%"),
    Threshold("unexplained", "missing tick numbers for which the history has no reason", 0.0, "ticks"),
    Threshold("bytes", "sealed record of a day, mean", 2.0, "MB"),
    Threshold("hottest", "hottest good reading of the air", 45.0, "degC"),
    Threshold("blind_heat", "ticks with the heater on and no good air reading", 0.0, "ticks"),
    Threshold("false_trips", "trips of safety or board outside provoked faults", 0.0, "trips"),
    Threshold("normal", "ticks of normal use, without a mark, of all", 60.0, "%", True),
    Threshold("controlled", "ticks of normal use under automatic control", 90.0, "%", True),
    Threshold("mae_reference_1", "MAE to the reference along reference 1", 0.6, "K"),
    Threshold("mae_reference_2", "MAE to the reference along reference 2", 0.5, "K"),
    Threshold("mae_normal", "MAE to the reference in normal use", 0.5, "K"),
    Threshold("near", f"ticks of normal use within {NEAR_K:g} K of the reference", 90.0, "%", True),
    Threshold("forecast", f"MAE of {FORECASTER}'s forecast {HORIZON_MIN} min ahead, normal use", 0.5, "K"),
    Threshold("against_persistence", "the same by that of persistence, along both references", 0.8, ""),
    Threshold(
        "heat_after", "ticks with the heater on 2 ticks after the sensor or USB is pulled", 0.0, "ticks"
    ),
    *(
        Threshold(
            fault.name, f"{fault.name}: named after, slowest of {REPEATS} or more", fault.within_min, "min"
        )
        for fault in FAULTS
    ),
)


def protocol_sha256() -> str:
    """Return the digest of all numbers above, for the start of a record."""
    numbers = {
        "days": [DAYS, DAY_SHARE],
        "repeats": REPEATS,
        "forecast": [FORECASTER, HORIZON_MIN],
        "near_k": NEAR_K,
        "faults": [asdict(fault) for fault in FAULTS],
        "thresholds": [asdict(threshold) for threshold in THRESHOLDS],
    }
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()
