"""LED photoperiod: on and off by the local clock."""

from edge.config.settings import LightingSettings


def led_level(settings: LightingSettings, second_of_day: float) -> float:
    """LED level for this time of day, 0..1. An `off` before `on` means a period over midnight."""
    if not settings.enabled:
        return 0.0
    begin = settings.on.hour * 3600 + settings.on.minute * 60 + settings.on.second
    end = settings.off.hour * 3600 + settings.off.minute * 60 + settings.off.second
    lit = begin <= second_of_day < end if begin < end else not end <= second_of_day < begin
    return settings.level if lit else 0.0
