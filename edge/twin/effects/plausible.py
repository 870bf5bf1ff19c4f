"""Check of a fitted twin: what it says of the fan that no fan does.

A fit takes such values where the tests do not tell heat by the fan from heat by something else; a plan on the
twin would then heat or cool with the fan, and the box would not follow.
"""

from collections.abc import Iterator

from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

FLOW_SHARE_MAX = 1.5  # of its free flow, which the box can only lower; some for an error of that figure
HEAT_SHARE_MAX = 0.5  # of the heater's power; the motor of a usual fan gives some hundredths
USUAL_SHARE = Value(0.8, rel_sd=0.3)  # of its free flow, behind a filter and against the box's resistance
_SHARE, _HEAT = ("effects", "fan_effectiveness", "eps_f"), ("effects", "fan_heat", "P_fan")


def implausible(file: TwinFile) -> Iterator[str]:
    """Say what is wrong with a twin's fan, nothing where it can be."""
    values = file.values()
    flow, heat = (values[place].value if place in values else 0.0 for place in (_SHARE, _HEAT))
    if flow > FLOW_SHARE_MAX:
        yield (
            f"the twin's fan changes {flow:.1f} times the air that it was said to move "
            f"({3600.0 * file.geometry['fan_max_m3_s'].value:.3g} m3/h): is that figure right?"
        )
    heater_w = file.geometry["heater_max_w"].value
    if heat > HEAT_SHARE_MAX * heater_w:
        yield f"the twin's fan heats by {heat:.0f} W, where the heater has {heater_w:.0f} W: no fan does that"


def with_usual_fan(description: TwinFile) -> TwinFile | None:
    """Return a description with a prior of the fan's flow, None where nothing fits it freely."""
    share = description.values().get(_SHARE)
    if share is None or not share.fit or share.rel_sd is not None:
        return None
    return description.with_values({_SHARE: USUAL_SHARE})
