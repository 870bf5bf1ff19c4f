"""Light by the local clock, and water by soil moisture: a pulse, then a pause to soak.

The interlock of the valve is in edge/safety/supervisor.py.
"""

from collections.abc import Iterable

from edge.config.settings import LightingSettings, WateringSettings
from edge.core.messages import Reading, ReadingQuality
from edge.safety.memory import Dose


def led_level(settings: LightingSettings, second_of_day: float) -> float:
    """LED level for this time of day, 0..1. An `off` before `on` means a period over midnight."""
    if not settings.enabled:
        return 0.0
    begin = settings.on.hour * 3600 + settings.on.minute * 60 + settings.on.second
    end = settings.off.hour * 3600 + settings.off.minute * 60 + settings.off.second
    lit = begin <= second_of_day < end if begin < end else not end <= second_of_day < begin
    return settings.level if lit else 0.0


def watering_pulse(
    settings: WateringSettings, soil: Reading | None, doses: Iterable[Dose], now: float, utc: float
) -> float:
    """Length of the pulse to give now, 0 for none [s]. A soil sensor that is not good gives no water."""
    if not settings.enabled or soil is None or soil.quality is not ReadingQuality.GOOD or soil.value is None:
        return 0.0
    recent = [dose for dose in doses if dose.is_recent(now, utc)]
    dry = soil.value < settings.threshold
    soaked = all(dose.age_s(now, utc) >= settings.soak_s for dose in recent)
    within_dose = sum(dose.length_s for dose in recent) + settings.pulse_s <= settings.daily_max_s
    return settings.pulse_s if dry and soaked and within_dose else 0.0
