"""Options that VictoriaMetrics has to be started with, checked against those that it says it has."""

import re
from collections.abc import Mapping

DEDUP = "dedup.minScrapeInterval"
DEDUP_VALUE = "1ms"  # removes samples of one series and time, and never a tick
RETENTION = "retentionPeriod"
DAYS = {"h": 1 / 24, "d": 1.0, "w": 7.0, "": 31.0, "y": 365.0}  # without a unit it means months of 31 days
_PERIOD = re.compile(r"([0-9.]+)([hdwy]?)")


def problem(options: Mapping[str, str], retention_days: float) -> str:
    """Return why an option is wrong, "" for none. retention_days : that the settings promise"""
    dedup = options.get(DEDUP, "")
    if dedup != DEDUP_VALUE:
        return f"-{DEDUP}={dedup}: must be {DEDUP_VALUE}, or a tick that comes twice is in store twice"
    kept_days = days(options.get(RETENTION, ""))
    if kept_days < retention_days:
        return f"-{RETENTION}: keeps {kept_days:g} days, but numbers.retention_days is {retention_days:g}"
    return ""


def days(period: str) -> float:
    """Return a period as VictoriaMetrics writes it, 0 for one that is none [days]."""
    found = _PERIOD.fullmatch(period)
    return float(found[1]) * DAYS[found[2]] if found else 0.0
