"""PID: the textbook's controller, the heater by its output, the fan by a rule when that is not enough."""

import math

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS, levels_allowed

# Chosen from a grid on the tuning references (training/control/tune.py at commit 02ed168c): of the settings
# within 5 % of the best those with the least derivative, as a real sensor has noise, and the fan that cools
# soonest.
KP = 0.6  # [1/K]
KI = 0.0004  # [1/(K s)]
KD = 60.0  # [s/K]
FILTER = 20.0  # the derivative filter is so many times faster than the derivative time; 2 to 20 are usual
FAN_ON_K = 1.0  # above the reference with the heater off: more than the box cools by itself in a minute
FAN_OFF_K = 0.3
GAP_STEPS = 3.0  # a longer pause between two decisions is none to integrate over
ROUNDING = 0.5 / HEATER_LEVELS + 1e-9  # of the duty: no saturation


class Pid:
    """`PID`. PID uses no forecast, and of the past only its integral.

    The derivative acts on the measurement, filtered, so that neither a step of the reference nor noise kicks.
    The integral follows the duty that was really sent (back-calculation), whoever cut the output: full heat,
    safety, a person, or a lost link. A takeover starts from the duty sent last, so that it makes no bump. The
    integral never rises above the duty sent: air above the set point would be heated as soon as it falls.
    Source : Åström and Hägglund, PID Controllers: Theory, Design, and Tuning, 2nd ed., ISA 1995, chapter 3
    """

    name = "PID"

    def __init__(self, kp: float = KP, ki: float = KI, kd: float = KD, fan_on_k: float = FAN_ON_K) -> None:
        """Gains as of a heater duty by kelvins."""
        self._gains = kp, ki, kd
        self._track_s = tracking_s(kp, ki, kd)
        self._fan_on_k = fan_on_k
        self.reset()

    def reset(self) -> None:
        """Forget the past; the next decision takes over from the duty sent last."""
        self._last_s: float | None = None
        self._last_c = self._output = 0.0
        self._proportional = self._integral = self._derivative = 0.0

    def decide(self, context: Context) -> Decision:
        """Heater and fan for this step; both off when the temperature is not known."""
        temp, reference = context.estimate.temp_air, float(context.reference[0])
        limits = context.limits
        top = levels_allowed(limits.heater_max_duty)
        excess = temp - reference
        duty = self._follow(context, temp, reference) if math.isfinite(excess) else 0.0
        level = min(round(duty * HEATER_LEVELS), top) if temp < limits.temp_air_max_c else 0
        last_on = context.last_sent.fan_on
        cool = level == 0 and math.isfinite(excess) and excess > (FAN_OFF_K if last_on else self._fan_on_k)
        if limits.fan_hold_steps > 0:
            cool = last_on
        why = {
            "reference_c": reference,
            "proportional": self._proportional,
            "integral": self._integral,
            "derivative": self._derivative,
        }
        return Decision(Command(heater_duty=level / HEATER_LEVELS, fan_on=cool), self.name, why=why)

    def _follow(self, context: Context, temp: float, reference: float) -> float:
        """Duty 0..1; the time passed is the context's, never the machine's."""
        kp, ki, kd = self._gains
        sent, error = context.last_sent.heater_duty, reference - temp
        passed_s = math.nan if self._last_s is None else context.now_s - self._last_s
        self._proportional = kp * error
        if 0.0 < passed_s <= GAP_STEPS * context.step_s:
            filter_s = kd / (kp * FILTER)
            falls = filter_s * self._derivative + kd * (self._last_c - temp)
            self._derivative = falls / (filter_s + passed_s)
            cut = sent - self._output
            back = min(passed_s / self._track_s, 1.0) * cut if abs(cut) > ROUNDING else 0.0
            integral = self._integral + passed_s * ki * error + back
            self._integral = min(max(integral, 0.0), max(self._integral, sent))
        else:
            self._derivative = 0.0
            self._integral = min(max(sent - self._proportional, 0.0), sent)
        self._last_s, self._last_c = context.now_s, temp
        self._output = self._proportional + self._integral + self._derivative
        return min(max(self._output, 0.0), 1.0)


def tracking_s(kp: float, ki: float, kd: float) -> float:
    """Return the time constant with which the integral follows the duty sent: sqrt(Ti Td), or Ti of a PI."""
    return math.sqrt(kd / ki) if kd > 0.0 else kp / ki
