"""Every fault the virtual board knows, with its parameters and their ranges."""

from dataclasses import dataclass

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
