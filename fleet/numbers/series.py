"""Names of series: `greenhouse_<quantity>` with its unit; the rig and others are labels."""

import json
from collections.abc import Iterable
from functools import cache

PREFIX = "greenhouse_"
SEQ = "seq"  # the tick's own number: of every tick, so it counts them

Samples = tuple[tuple[str, float], ...]  # head of a series, value


@cache  # a few hundred heads, whatever the number of rigs; callers let no name from outside in
def head(quantity: str, **labels: str | int) -> str:
    """Return a series' text up to the name of its rig. labels : words of this software's own"""
    known = "".join(f'{name}="{value}",' for name, value in labels.items())
    return f'{PREFIX}{quantity}{{{known}rig="'


def lines(rig: str, utc: float, samples: Samples) -> str:
    """Return samples of one time as VictoriaMetrics imports them. rig : a name fit for a topic; utc : [s]"""
    end = f'{rig}"}} '
    at_ms = f" {round(utc * 1000)}\n"
    return "".join([f"{start}{end}{value!r}{at_ms}" for start, value in samples])


def any_of(quantities: Iterable[str], rig: str) -> str:
    """Return the selector of all series of these quantities that a rig has."""
    return f'{{__name__=~"{"|".join(PREFIX + each for each in quantities)}",rig={json.dumps(rig)}}}'


def any_series(rig: str) -> str:
    """Return the selector of all series that a rig has, alarms about it too."""
    return f"{{rig={json.dumps(rig)}}}"


def selector(quantity: str, **labels: str) -> str:
    """Return the selector of a quantity's series with these labels, whose values may be of outside."""
    # JSON's quotes are PromQL's, so no name of a rig can end the text that it stands in.
    known = ",".join(f"{name}={json.dumps(value, ensure_ascii=False)}" for name, value in labels.items())
    return f"{PREFIX}{quantity}{{{known}}}"
