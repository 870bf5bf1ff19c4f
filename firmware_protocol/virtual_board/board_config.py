"""Configuration of a board: limits, optional parts, names. The defaults are those of PROTOCOL.md."""

from dataclasses import dataclass
from functools import reduce
from operator import or_

from firmware_protocol.messages import PROTOCOL_VERSION, Capability, Hello, ResetCause, pack

# The rig has no second cut-off and no tacho, and the simulated one is configured by its files.
_NOT_IN_THE_RIG = (Capability.HEATER_CUTOFF, Capability.FAN_TACHO, Capability.CONFIGURABLE)
RIG_PARTS = reduce(or_, (part for part in Capability if part not in _NOT_IN_THE_RIG))
PWM_SLOTS = 20


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """Raises LocalProtocolError for what the hello message cannot tell."""

    report_period_s: float = 1.0
    lease_max_s: float = 10.0
    temp_trip_c: float = 45.0
    valve_pulse_max_s: float = 10.0
    pwm_window_s: float = 20.0
    fan_safe_on: bool = False
    capabilities: Capability = RIG_PARTS
    board_id: int = 1
    firmware: tuple[int, int, int] = (1, 0, 0)

    def __post_init__(self) -> None:
        pack(self.hello(0, ResetCause.POWER_ON, 0), 0)

    def hello(self, session: int, reset_cause: ResetCause, boot_count: int) -> Hello:
        """Return the hello message of a board with this configuration."""
        return Hello(
            session=session,
            protocol_min=PROTOCOL_VERSION,
            protocol_max=PROTOCOL_VERSION,
            firmware_major=self.firmware[0],
            firmware_minor=self.firmware[1],
            firmware_patch=self.firmware[2],
            board_id=self.board_id,
            reset_cause=reset_cause,
            boot_count=boot_count,
            capabilities=self.capabilities,
            lease_max_s=self.lease_max_s,
            temp_trip_c=self.temp_trip_c,
            valve_pulse_max_s=self.valve_pulse_max_s,
            pwm_window_s=self.pwm_window_s,
            report_period_s=self.report_period_s,
            fan_safe_on=self.fan_safe_on,
        )

    def has(self, part: Capability) -> bool:
        """Return whether the board has an optional part."""
        return bool(self.capabilities & part)

    @property
    def report_period_ms(self) -> int:
        """Between two sensor reports [ms]."""
        return round(self.report_period_s * 1000)

    @property
    def lease_max_ms(self) -> int:
        """Longest lease of any output [ms]."""
        return round(self.lease_max_s * 1000)

    @property
    def temp_trip_raw(self) -> int:
        """Air temperature that trips [0.01 °C]."""
        return round(self.temp_trip_c * 100)

    @property
    def valve_pulse_max_ms(self) -> int:
        """Longest valve pulse [ms]; the wire carries tenths of a second."""
        return round(self.valve_pulse_max_s * 10) * 100

    @property
    def pwm_slot_ms(self) -> int:
        """One slot of the heater's window [ms]; the wire carries tenths of a second of the window."""
        return round(self.pwm_window_s * 10) * 100 // PWM_SLOTS
