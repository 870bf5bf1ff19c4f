"""Reasons for a decision, in sentences, for every controller."""

from collections.abc import Iterator, Mapping
from typing import Any


def reasons(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield the sentences for which `why` has values."""
    for tell in (_rule, _plan, _binding, _next_best, _values, _quote, _claims):
        yield from tell(why)


def _rule(why: Mapping[str, Any]) -> Iterator[str]:
    if "rule" in why:
        yield f"Its rule: {why['rule']}."


def _plan(why: Mapping[str, Any]) -> Iterator[str]:
    if "cost_tracking" in why:
        by = f" by {why['model']}" if "model" in why else ""
        parts = ", ".join(
            f"{part} {_number(why.get(f'cost_{part}'))}" for part in ("tracking", "heater", "fan")
        )
        yield f"Its plan costs {_number(why.get('cost'))}{by}: {parts}."
    if why.get("time_box_fired"):
        yield "The time limit ended its search."


def _binding(why: Mapping[str, Any]) -> Iterator[str]:
    if why.get("binding"):
        yield f"What bound it: {', '.join(why['binding'])}."


def _next_best(why: Mapping[str, Any]) -> Iterator[str]:
    other = why.get("runner_up")
    if other and "cost_more" in other:
        fan = "on" if other["fan_on"] else "off"
        yield (
            f"The next best began with heater {other['heater_duty']:.2f}, fan {fan}, "
            f"and costs {_number(other['cost_more'])} more."
        )


def _values(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield a policy's estimate of the value of its actions."""
    if "policy" in why:
        margin = (
            f", {_number(why['margin'])} more than the next best" if why.get("margin") is not None else ""
        )
        yield f"{why['policy']} takes that to be worth {_number(why.get('value'))}{margin}."


def _quote(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield a language model's reason, marked as its own words."""
    if "rationale" in why:
        yield f'The language model said: "{why["rationale"]}"'


def _claims(why: Mapping[str, Any]) -> Iterator[str]:
    for claim in why.get("claims", ()):
        if claim.get("holds") is False:
            yield f'That does not hold: "{claim["text"]}" ({claim.get("against", "nothing bears it out")}).'


def _number(value: Any) -> str:
    """Format a number; a value that was NaN when recorded is null in the history."""
    if not isinstance(value, int | float):
        return "not known"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
