"""The board's own safety: what may be driven, whatever the host says. See PROTOCOL.md, "Outputs", "Trip"."""

from dataclasses import dataclass, field

from firmware_protocol.frame import crc16
from firmware_protocol.messages import Capability, CommandMessage, HeaterOffCause, TripCause
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_outputs import Lease, Pins, SlowPwm
from firmware_protocol.virtual_board.board_samples import Sample

TRIP_HYSTERESIS = 300  # 0.01 K
TRIP_SAMPLES = 2
FAN_TIME_MS = 250  # a unit of a command's fan_on
_PERSISTENT_LAYOUT = 1
_BLANK = b"\xff" * 4
_NOTHING = CommandMessage(0, 0, 0, 0.0, True, 0.0)
_ALL_LATCHES = 15  # one bit for each cause
# The first of these that is latched is reported as the trip cause.
_REPORTED = (
    TripCause.EMERGENCY_STOP,
    TripCause.MAINTENANCE,
    TripCause.STORAGE_DAMAGED,
    TripCause.OVER_TEMPERATURE,
)


def latches_from(persistent: bytes) -> int:
    """Return the latches that a store holds; a torn write latches storage_damaged, since nobody knows."""
    if persistent in (b"", _BLANK):
        return 0
    intact = len(persistent) == 4 and crc16(persistent) == 0 and persistent[0] == _PERSISTENT_LAYOUT
    if not intact or persistent[1] > _ALL_LATCHES:
        return _latch(TripCause.STORAGE_DAMAGED)
    return persistent[1]


def _latch(cause: TripCause) -> int:
    """Return the bit of a cause, in the store and in memory."""
    return 1 << (cause - 1)


@dataclass(slots=True)
class _Leases:
    heater: Lease = field(default_factory=Lease)
    fan: Lease = field(default_factory=Lease)
    fan_time: Lease = field(default_factory=Lease)  # the part of `fan` in which it turns
    led: Lease = field(default_factory=Lease)
    valve: Lease = field(default_factory=Lease)
    valve_pulse: Lease = field(default_factory=Lease)

    def all(self) -> tuple[Lease, ...]:
        return self.heater, self.fan, self.fan_time, self.led, self.valve, self.valve_pulse


class Safety:
    """Leases, trip, air sample and heater relay. `advance` comes first at every entry."""

    def __init__(self, config: BoardConfig, persistent: bytes) -> None:
        self.greeted = False
        self._latches = latches_from(persistent)
        self._config = config
        self._command = _NOTHING  # the last one obeyed; each part of it holds while its lease runs
        self._leases = _Leases()
        self._pwm = SlowPwm(config.pwm_slot_ms)
        self._air = Sample()
        self._hot_samples = 0

    @property
    def trip_cause(self) -> TripCause:
        """Reported cause of all that is latched: a stop hides an over-temperature."""
        return next((cause for cause in _REPORTED if self._latches & _latch(cause)), TripCause.NONE)

    @property
    def tripped(self) -> bool:
        """True while anything is latched: no heat."""
        return self._latches != 0

    @property
    def stopped(self) -> bool:
        """True while hands may be in the greenhouse: nothing is driven, the fan neither."""
        return self._latches & ~_latch(TripCause.OVER_TEMPERATURE) != 0

    def persistent(self) -> bytes:
        """Return the bytes that must survive a reset."""
        body = bytes((_PERSISTENT_LAYOUT, self._latches))
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
        """Take a command's outputs.

        Return False, and take nothing, for heat while tripped and for anything while stopped.
        """
        driven = command.fan_on > 0 or command.led_pct > 0 or command.valve_pulse_s > 0
        if (self.tripped and command.heater_steps > 0) or (self.stopped and driven):
            return False
        self._command = command
        leases = self._leases
        granted = [leases.led, leases.valve]
        if self._air.good:
            granted += [leases.heater, leases.fan]
        for lease in granted:
            lease.grant(now_ms, round(command.lease_s * 1000), self._config.lease_max_ms)
        if self._air.good:
            on_ms = FAN_TIME_MS * command.fan_on if command.fan_on > 1 else leases.fan.length_ms
            leases.fan_time.grant(now_ms, on_ms, leases.fan.length_ms)
        if command.valve_pulse_s > 0:
            pulse_ms = round(command.valve_pulse_s * 1000)
            leases.valve_pulse.grant(now_ms, pulse_ms, self._config.valve_pulse_max_ms)
        self._pwm.reduce(self.heater_steps)
        return True

    def trip(self, cause: TripCause) -> None:
        """Latch a cause beside those that are latched already."""
        self._latches |= _latch(cause)
        for lease in self._leases.all():
            lease.end()
        self._pwm.reduce(0)

    def clear_trip(self) -> bool:
        """Clear over-temperature and storage damage, never a stop.

        Return False, and change nothing, while the air is too warm or not known.
        """
        cool_enough = self._config.temp_trip_raw - TRIP_HYSTERESIS
        cool = self._air.good and self._air.raw is not None and self._air.raw <= cool_enough
        clearable = _latch(TripCause.OVER_TEMPERATURE) | _latch(TripCause.STORAGE_DAMAGED)
        if self._latches & clearable and not cool:
            return False
        self._latches &= ~clearable
        return True

    def release(self, cause: TripCause) -> None:
        """End a stop or a maintenance; every other latch stays."""
        self._latches &= ~_latch(cause)

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
        """Return the LED's lease, the longest: its end ends the others [ms]."""
        return self._leases.led.left_ms(now_ms)

    @property
    def led_pct(self) -> int:
        """Brightness that may be driven now [%]."""
        return self._command.led_pct if self._leases.led.runs else 0

    def pins(self) -> Pins:
        """Return the outputs as they must be now."""
        leases, config = self._leases, self._config
        heater_may_run = leases.heater.runs and not self._command.cutoff_open
        asked = self._command.fan_on > 0 and leases.fan_time.runs
        fan = self.tripped or (asked if leases.fan.runs else config.fan_safe_on)
        return Pins(
            heater_relay=self._pwm.relay,
            fan=fan and not self.stopped,
            led=self.led_pct / 100,
            valve=leases.valve.runs and leases.valve_pulse.runs,
            cutoff_open=config.has(Capability.HEATER_CUTOFF) and (self.tripped or not heater_may_run),
        )
