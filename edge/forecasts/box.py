"""Whether a forecast leaves the box of the data that its predictor was fitted on."""

from typing import Protocol, runtime_checkable

from edge.models.base import Columns, Floats, Predictor
from edge.names import ACTUATORS, SIGNALS

_KEYS = {SIGNALS[name].key: name for name in ("temp_air", "temp_ambient")} | {
    ACTUATORS[name].key: name for name in ("heater_duty", "fan_on")
}


@runtime_checkable
class Boxed(Protocol):
    """A predictor that tells by itself."""

    def outside(self, history: Columns, controls: Floats, ahead: Columns, temps: Floats) -> bool:
        """Whether a rollout (as given to `rollout`, and what it returned, [B, N]) leaves the box."""
        ...


def is_outside(
    predictor: Predictor, history: Columns, controls: Floats, ahead: Columns, temps: Floats
) -> bool | None:
    """The predictor's own word, else its `validity` (lowest and highest value by column, as `Arx` has it).

    history, controls [N, 2], ahead : as the rollout had them; temps : what it returned [N] [°C]
    Returns : None for a predictor that knows no box
    """
    if isinstance(predictor, Boxed):
        return bool(predictor.outside(history, controls[None], ahead, temps[None]))
    validity = getattr(predictor, "validity", None)
    if not validity:
        return None
    values = {
        "temp_air": [history["temp_air"][-1:], temps],
        "temp_ambient": [ahead["temp_ambient"]],
        "heater_duty": [controls[:, 0]],
        "fan_on": [controls[:, 1]],
    }
    known = {_KEYS[key]: limits for key, limits in validity.items() if key in _KEYS}
    return not all(
        bool(((low <= column) & (column <= high)).all())  # NaN is outside
        for name, (low, high) in known.items()
        for column in values[name]
    )
