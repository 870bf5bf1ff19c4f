"""Whether a forecast leaves the box of the data that its predictor was fitted on."""

from edge.core.predictor import Columns, Floats, Predictor
from edge.models.validity import outside_steps


def is_outside(
    predictor: Predictor, history: Columns, controls: Floats, ahead: Columns, temps: Floats
) -> bool | None:
    """By the predictor's `validity`: the lowest and highest value of each column in the data of its fit.

    history, controls [N, 2], ahead : as the rollout had them; temps : what it returned [N] [°C]
    Returns : None for a predictor that knows no box
    """
    validity = getattr(predictor, "validity", None)
    if not validity:
        return None
    return bool(outside_steps(validity, history, controls[None], ahead, temps[None]).any())
