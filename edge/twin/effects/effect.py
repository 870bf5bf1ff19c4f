"""The row of an effect: everything that the twin and the diagnosis know about it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

Values = Mapping[str, float]  # an effect's values by parameter
UnitFactor = Callable[[str], float]  # of a unit: a value of the paper's box times it suits this box
# The likelihood of a dead time has a top in each row that it can end in: usually rows are a minute.
DEAD_TIMES_S = (15.0, 45.0, 80.0, 140.0, 200.0, 260.0)


class ParameterKind(Enum):
    """Meaning of a parameter that a fit or a check has to know."""

    PLAIN = "any other"
    AIR_LAG = "time constant [s] in series with the air's own, with which it can be mistaken"
    LAG = "other time constant [s]"
    DEAD_TIME = "delay [s], whose starts go with the length of a row"
    AIR_CAPACITIES = "heat capacity, in times the air's own"
    TURNING_POINT = (
        "air temperature [°C] about which the effect turns; a fit begins in the middle of the runs"
    )


class BlindRuns(Enum):
    """Recordings in which some effects do not show, each a sentence of `edge/diagnosis/cannot_tell.py`."""

    HEATER_STEADY = "the heater never changes"
    HEATER_ONE_LEVEL = "the heater knows only off and one level"
    FAN_OFF = "the fan never runs"
    FAN_STEADY = "the fan runs all the time"
    ROOM_UNKNOWN = "the room temperature was not recorded"
    ROOM_STEADY = "the room temperature stays, so constant heat and constant errors look the same"
    ROOM_STEADY_BODIES = "the room temperature stays, so bodies that store heat look the same"
    SHORT = "no run lasts an hour"
    LIGHT_STEADY = "the light never changes or was not recorded"
    HUMIDITY_UNKNOWN = "the humidity was not recorded"
    START_UNKNOWN = "not every run says when it began"
    ONE_DAY = "all runs began within a day"


class Offer(Enum):
    """Use that a diagnosis makes of an effect."""

    CANDIDATE = "sought, and named where it stands"
    KNOWN_ONLY = "acts where a twin file has it; never sought"
    NAMELESS = "bounded heat of unknown cause; never named"


class HiddenBy(NamedTuple):
    """Recordings that hide an effect.

    looks_like : the effect that it cannot be told from there, "" where its own group is meant
    place : in the sentence, smallest first; in the order of the library where it is the same
    """

    runs: BlindRuns
    looks_like: str = ""
    place: int = 0


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect, in values of the paper's box.

    low, high : range that is physically possible; start : usual value
    nothing_at : value at which the effect does nothing
    difference : share of the value by which a fit must move it to see a change; None: as little as usual
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    kind: ParameterKind = ParameterKind.PLAIN
    nothing_at: float = 0.0
    difference: float | None = None

    def problem(self, value: float) -> str:
        """Why `value` can't be, "" where it can."""
        if not math.isfinite(value):
            return f"{value} is not a finite number"
        if not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            return f"{value:g} is outside {self.low:g}..{self.high:g}{unit}"
        return ""


@dataclass(frozen=True, slots=True)
class Effect:
    """A row of the library.

    add : the function; the first line of its docstring is the effect in plain words and its equation
    source : where the equation is from
    without : the residual, measured minus predicted, where the effect is missing
    needs : columns beside the air, the room and the commands that a prediction needs
    offer : use that a diagnosis makes of it
    offered_with : columns without which it is not sought, though it acts without them
    by_flow : it acts on air that the fan changes, so it is not sought where the fan stirs or is missing
    starts : values of the paper's box from which a search fits it, near no effect where its size may be 0,
        else over the scales on which it can be seen; none: from the usual values
    check : a measurement by which a person can tell it without heater and fan
    hidden_by : recordings in which it does not show
    replaces : an effect that is not applied beside this one
    amounts_to : the replaced effect's values that its own are worth at rest
    starts_beside : starts from the replaced effect's known values, none where it is missing
    time_constant : formula and value [s], where no parameter is one
    common : rank among effects that most boxes have, which stand in for a name that fails; 0: not one of them
    stands_in : it may be added without being named where much is unexplained
    must_change : commands without whose change in the runs it can't be told
    counts_days : it counts days from the twin file's `day0_utc`
    gentler : an effect that often follows the data as well and that a plan along the twin's tangent sees
    """

    add: Callable[..., None]
    parameters: tuple[EffectParameter, ...]
    source: str
    without: str
    needs: tuple[str, ...] = ()
    offer: Offer = Offer.CANDIDATE
    offered_with: tuple[str, ...] = ()
    by_flow: bool = False
    starts: tuple[Values, ...] = ()
    check: str = ""
    hidden_by: tuple[HiddenBy, ...] = ()
    replaces: str = ""
    amounts_to: Callable[[Values], Values] | None = None
    starts_beside: Callable[[Values, UnitFactor], Sequence[Values]] | None = None
    time_constant: tuple[str, Callable[[Values], float]] | None = None
    common: int = 0
    stands_in: bool = False
    must_change: tuple[str, ...] = ()
    counts_days: bool = False
    gentler: str = ""

    @property
    def name(self) -> str:
        """The function's name, as a twin file and a report have it."""
        return self.add.__name__

    def parameter(self, name: str) -> EffectParameter:
        """By name. Errors: KeyError."""
        return {item.name: item for item in self.parameters}[name]


def by_name(*effects: Effect) -> dict[str, Effect]:
    """Return the effects by name."""
    return {effect.name: effect for effect in effects}
