"""The board's own safety: what may be driven, whatever the host says. See PROTOCOL.md, "Outputs", "Trip"."""

from dataclasses import dataclass, field

from firmware_protocol.frame import crc16
from firmware_protocol.messages import Capability, CommandMessage, HeaterOffCause, TripCause
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_outputs import Lease, Pins, SlowPwm
from firmware_protocol.virtual_board.board_samples import Sample

TRIP_HYSTERESIS = 300  # 0.01 K
TRIP_SAMPLES = 2
_PERSISTENT_LAYOUT = 1
_BLANK = b"\xff" * 4
_NOTHING = CommandMessage(0, False, 0, 0.0, True, 0.0)


def trip_from(persistent: bytes) -> TripCause:
    """The trip that a store holds; a torn write counts as one, since nobody knows."""
    if persistent in (b"", _BLANK):
        return TripCause.NONE
    intact = len(persistent) == 4 and crc16(persistent) == 0 and persistent[0] == _PERSISTENT_LAYOUT
    if not intact or persistent[1] not in tuple(TripCause):
        return TripCause.STORAGE_DAMAGED
    return TripCause(persistent[1])


@dataclass(slots=True)
class _Leases:
    heater: Lease = field(default_factory=Lease)
    fan: Lease = field(default_factory=Lease)
    led: Lease = field(default_factory=Lease)
    valve: Lease = field(default_factory=Lease)
    valve_pulse: Lease = field(default_factory=Lease)

    def all(self) -> tuple[Lease, ...]:
        return self.heater, self.fan, self.led, self.valve, self.valve_pulse


class Safety:
    """Leases, trip, air sample and heater relay. `advance` comes first at every entry."""

    def __init__(self, config: BoardConfig, persistent: bytes) -> None:
        self.greeted = False
        self.trip_cause = trip_from(persistent)
        self._config = config
        self._command = _NOTHING  # the last one obeyed; each part of it holds while its lease runs
        self._leases = _Leases()
        self._pwm = SlowPwm(config.pwm_slot_ms)
        self._air = Sample()
        self._hot_samples = 0

    @property
    def tripped(self) -> bool:
        """Whether a trip is latched."""
        return self.trip_cause is not TripCause.NONE

    def persistent(self) -> bytes:
        """What must survive a reset."""
        body = bytes((_PERSISTENT_LAYOUT, self.trip_cause))
        return body + crc16(body).to_bytes(2, "big")

    def advance(self, now_ms: int) -> None:
        """End what has run out."""
        for lease in self._leases.all():
            lease.advance(now_ms)
        if not self._leases.valve.runs:
            self._leases.valve_pulse.end()  # or the next command would open the valve again
        if not self._air.good:  # Samples.advance made it stale
            self._end_heat_and_fan()
        self._pwm.advance(now_ms, self.heater_steps)

    def sample_air(self, air: Sample) -> None:
        """Take a new air sample, good or not."""
        self._air = air
        if air.raw is None or not air.good:
            self._end_heat_and_fan()
        elif air.raw < self._config.temp_trip_raw:
            self._hot_samples = 0
        elif self._hot_samples < TRIP_SAMPLES:
            self._hot_samples += 1
            if self._hot_samples == TRIP_SAMPLES:
                self.trip(TripCause.OVER_TEMPERATURE)
        self._pwm.reduce(self.heater_steps)

    def obey(self, command: CommandMessage, now_ms: int) -> bool:
        """Take a command's outputs. False, and nothing is taken, when it asks for heat while tripped."""
        if self.tripped and command.heater_steps > 0:
            return False
        self._command = command
        leases = self._leases
        granted = [leases.led, leases.valve]
        if self._air.good:
            granted += [leases.heater, leases.fan]
        for lease in granted:
            lease.grant(now_ms, round(command.lease_s * 1000), self._config.lease_max_ms)
        if command.valve_pulse_s > 0:
            pulse_ms = round(command.valve_pulse_s * 1000)
            leases.valve_pulse.grant(now_ms, pulse_ms, self._config.valve_pulse_max_ms)
        self._pwm.reduce(self.heater_steps)
        return True

    def trip(self, cause: TripCause) -> None:
        """Latch a trip; the first cause stays."""
        if not self.tripped:
            self.trip_cause = cause
        for lease in self._leases.all():
            lease.end()
        self._pwm.reduce(0)

    def clear_trip(self) -> bool:
        """Forget the trip. False, and it stays, while the air is too warm or not known."""
        cool_enough = self._config.temp_trip_raw - TRIP_HYSTERESIS
        cool = self._air.good and self._air.raw is not None and self._air.raw <= cool_enough
        if self.tripped and not cool:
            return False
        self.trip_cause = TripCause.NONE
        return True

    def _end_heat_and_fan(self) -> None:
        self._leases.heater.end()
        self._leases.fan.end()

    @property
    def heater_steps(self) -> int:
        """Duty that may be driven now [1/20]."""
        allowed = not self.tripped and self.greeted and self._air.good and self._leases.heater.runs
        return self._command.heater_steps if allowed else 0

    @property
    def heater_off_cause(self) -> HeaterOffCause:
        """Why the duty is 0, NONE when it is not."""
        if self.heater_steps > 0:
            return HeaterOffCause.NONE
        if self.tripped:
            return HeaterOffCause.TRIPPED
        if not self.greeted:
            return HeaterOffCause.NOT_GREETED
        if not self._air.good:
            return HeaterOffCause.SENSOR_FAULT
        return HeaterOffCause.COMMANDED if self._leases.heater.runs else HeaterOffCause.LEASE_EXPIRED

    def lease_left_ms(self, now_ms: int) -> int:
        """The LED's lease: it is the longest, whatever ends it ends the others."""
        return self._leases.led.left_ms(now_ms)

    @property
    def led_pct(self) -> int:
        """Brightness that may be driven now [%]."""
        return self._command.led_pct if self._leases.led.runs else 0

    def pins(self) -> Pins:
        """What the outputs must show now."""
        leases, config = self._leases, self._config
        heater_may_run = leases.heater.runs and not self._command.cutoff_open
        return Pins(
            heater_relay=self._pwm.relay,
            fan=self.tripped or (self._command.fan_on if leases.fan.runs else config.fan_safe_on),
            led=self.led_pct / 100,
            valve=leases.valve.runs and leases.valve_pulse.runs,
            cutoff_open=config.has(Capability.HEATER_CUTOFF) and (self.tripped or not heater_may_run),
        )
