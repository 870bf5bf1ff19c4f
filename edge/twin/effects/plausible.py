"""Check of a fitted twin: what it says of the fan that no fan does.

A fit takes such values where the tests do not tell heat by the fan from heat by something else; a plan on the
twin would then heat or cool with the fan, and the box would not follow.
"""

from collections.abc import Iterator

from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

# Of its free flow, which the box can only lower; but many a figure of a flow is wrong. Both unseen boxes with
# 1.7 were held for half the cost of the paper's MPC (docs/measured/control.md). A fit's range ends at 2.
FLOW_SHARE_ODD, FLOW_SHARE_MAX = 1.5, 1.9
HEAT_SHARE_MAX = 0.5  # of the heater's power; the motor of a usual fan gives some hundredths
USUAL_SHARE = Value(0.8, rel_sd=0.3)  # of its free flow, behind a filter and against the box's resistance
_SHARE, _HEAT = ("effects", "fan_effectiveness", "eps_f"), ("effects", "fan_heat", "P_fan")


def implausible(file: TwinFile) -> Iterator[str]:
    """Say what is wrong with a twin's fan, nothing where it can be."""
    if _value(file, _SHARE) > FLOW_SHARE_MAX:
        yield _odd_flow(file)
    heater_w, heat_w = file.geometry["heater_max_w"].value, _value(file, _HEAT)
    if heat_w > HEAT_SHARE_MAX * heater_w:
        yield (
            f"the twin's fan heats by {heat_w:.0f} W, where the heater has {heater_w:.0f} W: no fan does that"
        )


def odd(file: TwinFile) -> Iterator[str]:
    """Say what is odd about a twin's fan and can be all the same."""
    if FLOW_SHARE_ODD < _value(file, _SHARE) <= FLOW_SHARE_MAX:
        yield _odd_flow(file)


def with_usual_fan(description: TwinFile) -> TwinFile | None:
    """Return a description with a prior of the fan's flow, None where nothing fits it freely."""
    share = description.values().get(_SHARE)
    if share is None or not share.fit or share.rel_sd is not None:
        return None
    return description.with_values({_SHARE: USUAL_SHARE})


def _value(file: TwinFile, place: Place) -> float:
    values = file.values()
    return values[place].value if place in values else 0.0


def _odd_flow(file: TwinFile) -> str:
    return (
        f"the twin's fan changes {_value(file, _SHARE):.1f} times the air that it was said to move "
        f"({3600.0 * file.geometry['fan_max_m3_s'].value:.3g} m3/h): is that figure right?"
    )
