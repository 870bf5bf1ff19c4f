"""Checks of a board's outputs: drive one for some seconds, and look for its effect where a sensor shows it.

The computer renews a short lease. So a killed process, a lost line or a hung terminal leaves nothing driven.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import fmean

from edge.board.board_session import OFF, BoardSession
from edge.core.errors import RequestError
from edge.core.names import HEATER_LEVELS
from firmware_protocol.board_block import NO_PIN, Output, decode_block
from firmware_protocol.messages import Capability, CommandMessage, Quality, SensorReport, StateEcho

LEASE_S = 3.0  # so long an output may outlive the process; a usual board's reports renew it every second
SAMPLES = 5  # of a mean, against the noise of one sample
SAY_EVERY = 5  # samples
SHORTEST_S = 0.1  # a shorter lease would be over before its answer comes
HEAT_BELOW_C = 35.0  # two minutes of full duty warm by a few kelvin; the usual limit is 40
NOT_GOOD = "the air temperature is not good; the board obeys no heater and no fan without it"
Say = Callable[[str], None]


class OutputRefused(RequestError):
    """An output that must not be driven now; the board still answers."""


@dataclass(frozen=True, slots=True)
class OutputCheck:
    """A check of one output.

    label, action, question : for the person who looks on
    seconds : longest time that the output is driven [s]
    signal, rise : key of the report, and the rise that shows an effect; "" where no sensor can
    after_s : time after the output is off in which the effect still may come [s]
    is_fan : a tacho shows its effect, where there is one
    """

    label: str
    action: str
    question: str
    command: CommandMessage
    seconds: float
    signal: str = ""
    rise: float = 0.0
    after_s: float = 0.0
    is_fan: bool = False


_ON = replace(OFF, cutoff_open=False)  # of every check
CHECKS = {
    "heater": OutputCheck(
        "Heater",
        "full duty; ends as soon as the air is 0.5 K warmer",
        "Did the heater get warm? Do not touch it",
        replace(_ON, heater_steps=HEATER_LEVELS),
        120.0,  # a ceramic element of 100 W first warms itself
        "temp_air_c",
        0.5,  # five steps of a DHT22; the air of a closed box drifts less within three minutes
        after_s=60.0,
    ),
    "fan": OutputCheck("Fan", "on", "Did the fan turn?", replace(_ON, fan_on=1), 5.0, is_fan=True),
    "led": OutputCheck(
        "Light", "full light", "Did the light come on?", replace(_ON, led_pct=100), 5.0, "light", 0.02
    ),
    "valve": OutputCheck(
        "Water valve",
        "one pulse; a little water flows",
        "Did the valve open?",
        replace(_ON, valve_pulse_s=1.0),
        1.0,
    ),
}

# Boards usually run the fan without a command, so that only its stop shows anything.
FAN_STOPS = replace(
    CHECKS["fan"],
    action="it runs by itself, and is turned off",
    question="Did the fan stop, and start again?",
    command=_ON,
)


def outputs(session: BoardSession) -> tuple[str, ...]:
    """Return the names of the outputs that the board has, keys of CHECKS. Errors: RequestError"""
    block = session.block()
    if block is None:
        parts = session.hello.capabilities
        optional = {"led": Capability.LED, "valve": Capability.VALVE}
        return tuple(name for name in CHECKS if name not in optional or optional[name] & parts)
    try:
        pins = decode_block(block).pins
    except ValueError as error:
        raise RequestError(
            f"the board has no configuration: {error}. `greenhouse board configure FILE` writes one; "
            "then run the same command again"
        ) from None
    return tuple(name for name in CHECKS if pins[Output[name.upper()]] != NO_PIN)


def suited_check(session: BoardSession, name: str) -> OutputCheck:
    """Return the check of one output, as it suits this board."""
    return FAN_STOPS if name == "fan" and session.hello.fan_safe_on else CHECKS[name]


def run_check(session: BoardSession, check: OutputCheck, say: Say) -> bool | None:
    """Drive one output and look for its effect. The output is off when this returns or raises.

    Returns : True where a sensor shows the effect, False where it does not, None where no sensor can
    Errors : OutputRefused, RequestError for a lost line
    """
    _check_held(session.state())  # its answer comes after the reports that wait on the line
    sensor = _Sensor(check, session, say)
    try:
        effect = _drive(session, check, check.command, check.seconds, sensor)
        if effect is False and check.after_s:
            say(f"  off; waits up to {check.after_s:g} s for the heat to arrive")
            # Without the fan, which would take the heat away.
            effect = _drive(session, check, _ON, check.after_s, sensor)
    finally:
        session.turn_off()
    return effect


class _Sensor:
    """A check's signal: the mean before, and the newest samples that are compared with it."""

    def __init__(self, check: OutputCheck, session: BoardSession, say: Say) -> None:
        self._check = check
        self._say = say
        self._taken = 0
        self._recent: list[float] = []
        values = [self._value(session.report()) for _ in range(SAMPLES if check.signal else 0)]
        good = [value for value in values if value is not None]
        self._before = fmean(good) if good and len(good) == len(values) else None
        self._check_heat(self._before)

    def take(self, report: SensorReport) -> bool | None:
        """Return whether the effect shows by now, None where it cannot. Errors: OutputRefused for hot air"""
        value = self._value(report)
        self._check_heat(value)
        if self._before is None:
            return None
        self._recent = [] if value is None else [*self._recent, value][-SAMPLES:]
        if not self._recent:
            return False
        change = fmean(self._recent) - self._before
        self._taken += 1
        if self._taken % SAY_EVERY == 0:
            self._say(f"  {self._taken:3d}: {self._recent[-1]:.4g} (change {change:+.2f})")
        return len(self._recent) == SAMPLES and change >= self._check.rise

    def _value(self, report: SensorReport) -> float | None:
        signal = self._check.signal
        if not signal or getattr(report, f"{signal.removesuffix('_c')}_quality") is not Quality.GOOD:
            return None
        value: float | None = getattr(report, signal)
        return value

    def _check_heat(self, air_c: float | None) -> None:
        """Refuse to heat air that is hot or not known; NaN is refused too."""
        if not self._check.command.heater_steps:
            return
        if air_c is None:
            raise OutputRefused(NOT_GOOD)
        if not air_c < HEAT_BELOW_C:
            raise OutputRefused(
                f"the air has {air_c:.1f} °C; the heater is checked below {HEAT_BELOW_C:g} °C"
            )


def _drive(
    session: BoardSession, check: OutputCheck, command: CommandMessage, seconds: float, sensor: _Sensor
) -> bool | None:
    """Renew the lease until the effect is seen or the time is over; the last lease ends with the time."""
    end_s = session.clock.now() + seconds
    lease_s = max(LEASE_S, 2.0 * session.hello.report_period_s)
    effect = None
    while (left_s := end_s - session.clock.now()) > SHORTEST_S:
        echo = session.drive(replace(command, lease_s=round(min(lease_s, left_s), 3)))
        _check_driven(check, command, echo)
        command = replace(command, valve_pulse_s=0.0)  # a renewal must not open the valve again
        effect = sensor.take(session.report())
        if check.is_fan and echo.fan_rpm is not None:
            effect = (echo.fan_rpm > 0) == bool(command.fan_on)
        if effect:
            break
    return effect


def _check_held(echo: StateEcho) -> None:
    if echo.tripped:
        raise OutputRefused(
            f"the board holds everything off: {echo.trip_cause.name.lower().replace('_', ' ')}"
        )


def _check_driven(check: OutputCheck, command: CommandMessage, echo: StateEcho) -> None:
    """Refuse where the board obeys but does not drive."""
    _check_held(echo)
    disobeys = check.is_fan and echo.fan_on != bool(command.fan_on)
    if disobeys or echo.heater_steps < command.heater_steps:
        raise OutputRefused(NOT_GOOD)
