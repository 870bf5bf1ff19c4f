"""PID: the textbook's controller, the heater by its output, the fan by a rule when that is not enough."""

import math

from simple_pid import PID

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS, levels_allowed

# Chosen from a grid on the tuning references (training/control/tune.py at commit 02ed168c): of the settings
# within 5 % of the best those with the least derivative, as a real sensor has noise, and the fan that cools
# soonest.
KP = 0.6  # [1/K]
KI = 0.0004  # [1/(K s)]
KD = 60.0  # [s/K]
FAN_ON_K = 1.0  # above the reference with the heater off: more than the box cools by itself in a minute
FAN_OFF_K = 0.3
GAP_STEPS = 3.0  # a longer pause between two decisions is none to integrate over


class Pid:
    """`PID`. It never sees ahead: what it knows of the past is its integral."""

    name = "PID"

    def __init__(self, kp: float = KP, ki: float = KI, kd: float = KD, fan_on_k: float = FAN_ON_K) -> None:
        """Gains as of a heater duty by kelvins; the integral is limited to the duties there are."""
        self._gains = kp, ki, kd
        self._fan_on_k = fan_on_k
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the time."""
        self._pid = PID(*self._gains, sample_time=None, output_limits=(0.0, 1.0))
        self._last_s: float | None = None

    def decide(self, context: Context) -> Decision:
        """Heater and fan for this step; both off when the temperature is not known."""
        temp, reference = context.estimate.temp_air, float(context.reference[0])
        limits = context.limits
        top = levels_allowed(limits.heater_max_duty)
        excess = temp - reference
        duty = self._output(context, temp, reference) if math.isfinite(excess) else 0.0
        level = min(round(duty * HEATER_LEVELS), top) if temp < limits.temp_air_max_c else 0
        last_on = context.last_sent.fan_on
        cool = level == 0 and math.isfinite(excess) and excess > (FAN_OFF_K if last_on else self._fan_on_k)
        if limits.fan_hold_steps > 0:
            cool = last_on
        proportional, integral, derivative = self._pid.components
        why = {
            "reference_c": reference,
            "proportional": proportional,
            "integral": integral,
            "derivative": derivative,
        }
        return Decision(Command(heater_duty=level / HEATER_LEVELS, fan_on=cool), self.name, why=why)

    def _output(self, context: Context, temp: float, reference: float) -> float:
        """Duty 0..1; the time passed is the context's, never the machine's."""
        passed_s = context.step_s if self._last_s is None else context.now_s - self._last_s
        if not 0.0 < passed_s <= GAP_STEPS * context.step_s:
            self.reset()
            passed_s = context.step_s
        self._last_s = context.now_s
        self._pid.setpoint = reference
        return float(self._pid(temp, dt=passed_s) or 0.0)
