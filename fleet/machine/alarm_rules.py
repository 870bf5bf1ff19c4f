"""Rules of vmalert over the numbers of all rigs: silent, hot, tripped, without board or air temperature."""

from typing import Any

import yaml

from fleet.numbers.series import PREFIX, SEQ
from fleet.page.alarm_shelf import WATCHDOG
from fleet.settings import AlarmRuleSettings

HEAD = "# For vmalert. Written by `greenhouse fleet up`; a change by hand is lost.\n"
EVERY = "30s"
SEEN = "1d"  # a rig that was silent for longer is no alarm any more; the page still lists it as offline
RECENT = "5m"  # a tick more or less is not waited for


def alarm_rules(settings: AlarmRuleSettings) -> str:
    """Return the rules as YAML."""
    return HEAD + yaml.safe_dump(
        {"groups": [{"name": "greenhouse", "interval": EVERY, "rules": _rules(settings)}]}, sort_keys=False
    )


def _rules(settings: AlarmRuleSettings) -> list[dict[str, Any]]:
    silent_s, air_max_c = settings.silent_s, settings.air_max_c
    last = f"max by (rig) (tlast_over_time({PREFIX}{SEQ}[{SEEN}]))"
    rig = "{{ $labels.rig }}"
    return [
        # It always holds: while it comes, somebody watches.
        _rule(WATCHDOG, "vector(1)", "info", "vmalert watches"),
        _rule(
            "fleet_silent",
            f"time() - max(tlast_over_time({PREFIX}{SEQ}[{SEEN}])) > {silent_s:g}",
            "alarm",
            "no rig has told anything for {{ $value | humanizeDuration }}: broker or ingest may be away",
        ),
        _rule(
            "rig_silent",
            f"time() - {last} > {silent_s:g}",
            "alarm",
            f"{rig}: no tick for {{{{ $value | humanizeDuration }}}}",
        ),
        _rule(
            "air_too_hot",
            f"max by (rig) (max_over_time({PREFIX}temp_air_c[{RECENT}])) > {air_max_c:g}",
            "alarm",
            f'{rig}: air at {{{{ $value | printf "%.1f" }}}} °C, above {air_max_c:g} °C',
        ),
        _rule(
            "rig_tripped",
            f"max by (rig) (max_over_time({PREFIX}echo_tripped[{RECENT}])) > 0",
            "alarm",
            f"{rig}: its board has tripped",
        ),
        _rule(
            "board_silent",
            f"max by (rig) (max_over_time({PREFIX}link_up[{RECENT}])) == 0",
            "alarm",
            f"{rig}: its board is silent",
        ),
        _rule(
            "no_air_temperature",
            f"min by (rig) (min_over_time({PREFIX}temp_air_c_quality[{RECENT}])) > 0",
            "alarm",
            f"{rig}: no trustworthy air temperature for 5 minutes",
        ),
    ]


def _rule(name: str, expression: str, severity: str, words: str) -> dict[str, Any]:
    return {
        "alert": name,
        "expr": expression,
        "labels": {"severity": severity},
        "annotations": {"text": words},
    }
