"""Faults of the virtual board: the table of all, and a script that is checked once and becomes a schedule."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml

from firmware_protocol.messages import LAYOUTS, SensorReport

SIGNALS = tuple(field.name for field in LAYOUTS[SensorReport].fields[1::2])  # value and quality in turn
CAUSES = ("external", "watchdog", "software", "power_on")
FOREVER = float("inf")

Value = float | str


@dataclass(frozen=True, slots=True)
class Number:
    """A numeric parameter; without a default it must be given."""

    low: float
    high: float
    default: float | None = None


@dataclass(frozen=True, slots=True)
class Choice:
    """A parameter that is one of a few words; without a default it must be given."""

    words: tuple[str, ...]
    default: str | None = None


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A fault's parameters, and how long it lasts unless told otherwise [s]; None: it happens at once."""

    duration_s: float | None
    parameters: dict[str, Number | Choice]


_DIRECTION = Choice(("both", "to_host", "to_board"), "both")
_RATE = Number(0.0, 1.0, 0.01)
_SIGNAL = Choice(SIGNALS, "temp_air_c")
_BOOT = Number(0.0, 60.0, 1.5)
_ANY = 1e6

KINDS: dict[str, FaultKind] = {
    # The line. A rate is a probability per byte.
    "drop_bytes": FaultKind(FOREVER, {"rate": _RATE, "direction": _DIRECTION}),
    "duplicate_bytes": FaultKind(FOREVER, {"rate": _RATE, "direction": _DIRECTION}),
    "flip_bits": FaultKind(FOREVER, {"rate": _RATE, "direction": _DIRECTION}),  # one bit of the byte
    "garbage": FaultKind(None, {"count": Number(1, 4096, 64), "direction": _DIRECTION}),
    "delay": FaultKind(FOREVER, {"delay_s": Number(0.0, 60.0, 0.5), "direction": _DIRECTION}),
    "mute": FaultKind(FOREVER, {"direction": _DIRECTION}),
    "unplug": FaultKind(FOREVER, {}),  # it is plugged in again at the end
    # The board. While it boots all outputs are off and the line is silent.
    "reset": FaultKind(None, {"cause": Choice(CAUSES, "external"), "boot_time_s": _BOOT}),
    "brown_out": FaultKind(
        None, {"count": Number(1, 1000, 3), "period_s": Number(0.1, 3600.0, 4.0), "boot_time_s": _BOOT}
    ),
    "clock_wrap": FaultKind(
        None, {"before_s": Number(0.0, 4e6, 30.0)}
    ),  # board_ms jumps to so long before it
    "clock_drift": FaultKind(FOREVER, {"factor": Number(0.01, 100.0, 1.01)}),
    "other_protocol": FaultKind(FOREVER, {"version": Number(3, 255, 3)}),
    # What a sensor shows.
    "sensor_none": FaultKind(FOREVER, {"signal": _SIGNAL}),  # no number, quality fault
    "sensor_nan": FaultKind(FOREVER, {"signal": _SIGNAL}),  # not a number, and the driver says good
    "sensor_value": FaultKind(
        FOREVER, {"signal": _SIGNAL, "value": Number(-_ANY, _ANY)}
    ),  # e.g. out of range
    "sensor_stuck": FaultKind(FOREVER, {"signal": _SIGNAL}),  # at what it showed last
    "sensor_offset": FaultKind(FOREVER, {"signal": _SIGNAL, "offset": Number(-_ANY, _ANY)}),
    "sensor_spike": FaultKind(  # a rate is a probability per sample
        1.0, {"signal": _SIGNAL, "size": Number(-_ANY, _ANY), "rate": Number(0.0, 1.0, 1.0)}
    ),
    # What flows, whatever the pin says.
    "heater_stuck_on": FaultKind(FOREVER, {}),  # a second cut-off still interrupts it
    "heater_dead": FaultKind(FOREVER, {}),
    "fan_stuck_on": FaultKind(FOREVER, {}),
    "fan_stuck_off": FaultKind(FOREVER, {}),
}


LATEST_S = 1e9  # of a start or a finite duration


class FaultError(Exception):
    """A fault that can't be: `faults.yaml: fault 2: unknown fault 'unplugg'; nearest known: 'unplug'`."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardFault:
    """One fault, all parameters filled in; `random` is its own, so others do not shift its dice."""

    name: str
    start_ms: int
    end_ms: float  # infinite: for ever; equal to start_ms: happens at once
    parameters: Mapping[str, Value]
    random: random.Random

    def number(self, key: str) -> float:
        """Return a numeric parameter."""
        return float(self.parameters[key])

    def concerns(self, direction: str) -> bool:
        """Return whether it is a line fault of this direction, `to_host` or `to_board`."""
        return self.parameters.get("direction") in ("both", direction)


def read_script(path: Path, seed: int) -> list[BoardFault]:
    """Read the faults of a YAML list. Errors: FaultError with file and number of the fault"""
    try:
        script = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, RecursionError, yaml.YAMLError) as error:
        raise FaultError(f"{path}: {error}") from error
    if not isinstance(script, list):
        raise FaultError(f"{path}: a fault script is a list of faults")
    return [
        make_fault(entry, now_ms=0, seed=f"{seed}/{number}", place=f"{path}: fault {number}")
        for number, entry in enumerate(script, 1)
    ]


def make_fault(entry: object, *, now_ms: int, seed: str, place: str) -> BoardFault:
    """Make a fault from its mapping `{name, start_s, duration_s, seed, ...parameters}`.

    now_ms : its start unless it says one; it can't start before
    seed : of its dice, unless it says one
    Errors : FaultError, beginning with `place`
    """
    if not isinstance(entry, Mapping):
        raise FaultError(f"{place}: a fault is a mapping with a name")
    name = entry.get("name")
    if name not in KINDS:
        raise FaultError(f"{place}: unknown fault {name!r}; {_nearest(name, KINDS)}")
    kind, place = KINDS[name], f"{place}: {name}"
    _refuse_unknown_keys(entry, kind, place)
    start_s = _number(entry.get("start_s", now_ms / 1000), Number(0.0, LATEST_S), f"{place}: start_s")
    start_ms = round(start_s * 1000)
    if start_ms < now_ms:
        raise FaultError(f"{place}: start_s: {start_s:g} has passed, it is {now_ms / 1000:g}")
    return BoardFault(
        name=name,
        start_ms=start_ms,
        end_ms=start_ms + _duration_ms(entry, kind, place),
        parameters={key: _parameter(entry, key, kind, place) for key in kind.parameters},
        random=random.Random(str(entry.get("seed", seed))),
    )


def _refuse_unknown_keys(entry: Mapping[object, object], kind: FaultKind, place: str) -> None:
    known = ["name", "start_s", "seed", *kind.parameters]
    if kind.duration_s is not None:
        known.append("duration_s")
    for key in entry:
        if key not in known:
            raise FaultError(f"{place}: unknown key {key!r}; {_nearest(key, known)}")


def _duration_ms(entry: Mapping[str, Any], kind: FaultKind, place: str) -> float:
    if kind.duration_s is None:
        return 0
    if "duration_s" not in entry:
        return kind.duration_s * 1000
    return round(_number(entry["duration_s"], Number(0.001, LATEST_S), f"{place}: duration_s") * 1000)


def _parameter(entry: Mapping[str, Any], key: str, kind: FaultKind, place: str) -> Value:
    allowed = kind.parameters[key]
    value = entry.get(key, allowed.default)
    if value is None:
        raise FaultError(f"{place}: {key} is missing")
    if isinstance(allowed, Number):
        return _number(value, allowed, f"{place}: {key}")
    return _word(value, allowed, f"{place}: {key}")


def _number(value: object, allowed: Number, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FaultError(f"{place}: {value!r} is not a number")
    if not allowed.low <= value <= allowed.high:  # NaN lands here too
        raise FaultError(f"{place}: {value} is outside {allowed.low:g}..{allowed.high:g}")
    return value


def _word(value: object, allowed: Choice, place: str) -> str:
    if not isinstance(value, str) or value not in allowed.words:
        raise FaultError(f"{place}: unknown {value!r}; {_nearest(value, allowed.words)}")
    return value


def _nearest(word: object, known: Any) -> str:
    close = get_close_matches(str(word), known, n=1, cutoff=0.5)
    return f"nearest known: {close[0]!r}" if close else f"known: {sorted(known)}"


class Schedule:
    """Which faults begin, last and end when."""

    def __init__(self, faults: list[BoardFault]) -> None:
        self._waiting = sorted(faults, key=lambda fault: fault.start_ms)
        self.active: list[BoardFault] = []
        self.next_change_ms: float = 0

    def add(self, fault: BoardFault) -> None:
        """One more; it begins at the next `pass_to` at or after its start."""
        self._waiting = sorted([*self._waiting, fault], key=lambda other: other.start_ms)
        self._look_ahead()

    def clear(self) -> None:
        """No fault any more; what one has done (a reset, a trip) stays done."""
        self._waiting.clear()
        self.active.clear()
        self._look_ahead()

    def pass_to(self, now_ms: int) -> list[BoardFault]:
        """Let time pass; the faults that begin, in order. `active` then holds those that last."""
        begin = [fault for fault in self._waiting if fault.start_ms <= now_ms]
        self._waiting = self._waiting[len(begin) :]
        self.active = [fault for fault in self.active + begin if now_ms < fault.end_ms]
        self._look_ahead()
        return begin

    def _look_ahead(self) -> None:
        starts = [fault.start_ms for fault in self._waiting[:1]]
        self.next_change_ms = min([*starts, *(fault.end_ms for fault in self.active)], default=float("inf"))
