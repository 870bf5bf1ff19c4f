"""Light by the local clock, and water by soil moisture: a pulse, then a pause to soak.

The interlock of the valve is in edge/safety/supervisor.py.
"""

import math

from edge.config.settings import LightingSettings, WateringSettings
from edge.core.messages import Reading, ReadingQuality


def led_level(settings: LightingSettings, second_of_day: float) -> float:
    """LED level for this time of day, 0..1. An `off` before `on` means a period over midnight."""
    if not settings.enabled:
        return 0.0
    begin = settings.on.hour * 3600 + settings.on.minute * 60 + settings.on.second
    end = settings.off.hour * 3600 + settings.off.minute * 60 + settings.off.second
    lit = begin <= second_of_day < end if begin < end else not end <= second_of_day < begin
    return settings.level if lit else 0.0


DAY_S = 86400.0


class Watering:
    """Decides on pulses; remembers those that the board confirmed."""

    def __init__(self, settings: WateringSettings) -> None:
        self._settings = settings
        self._pulses: list[tuple[float, float]] = []  # time [s], length [s], of the last 24 hours

    def pulse(self, soil: Reading | None, now: float) -> float:
        """Length of the pulse to give now, 0 for none [s]. A soil sensor that is not good gives no water."""
        settings = self._settings
        if (
            not settings.enabled
            or soil is None
            or soil.quality is not ReadingQuality.GOOD
            or soil.value is None
        ):
            return 0.0
        recent = [(time_s, length_s) for time_s, length_s in self._pulses if now - time_s < DAY_S]
        last_s = max((time_s for time_s, _ in recent), default=-math.inf)
        dry = soil.value < settings.threshold
        soaked = now - last_s >= settings.soak_s
        within_dose = sum(length_s for _, length_s in recent) + settings.pulse_s <= settings.daily_max_s
        return settings.pulse_s if dry and soaked and within_dose else 0.0

    def count_pulse(self, length_s: float, now: float) -> None:
        """Count a pulse that was sent; one that may not have reached the board counts too."""
        if length_s > 0.0:
            self._pulses = [pulse for pulse in self._pulses if now - pulse[0] < DAY_S]
            self._pulses.append((now, length_s))
