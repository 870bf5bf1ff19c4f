"""Controllers by their public names."""

from edge.config_schema import nearest
from edge.controllers.base import Controller
from edge.controllers.mpc import Mpc
from edge.controllers.rules import Rules
from edge.errors import RequestError
from edge.models.base import Predictor
from edge.settings import ControlSettings

NAMES = ("rules", "MPC", "MPC-P", "MPC-BFGS", "MPC-BFGS-P")


def make(name: str, settings: ControlSettings, model: Predictor) -> Controller:
    """The controller called `name`. Raises RequestError for a name nobody has."""
    if name not in NAMES:
        raise RequestError(f"controller: there is no {name!r}; {nearest(name, NAMES)}")
    if name == "rules":
        return Rules()
    weight = 1.0 if name.endswith("-P") else 0.0
    if name.startswith("MPC-BFGS"):
        from edge.controllers.mpc_bfgs import MpcBfgs  # late: it needs scipy

        return MpcBfgs(name, model, weight, settings.horizon)
    return Mpc(name, model, weight, settings.horizon, settings.node_budget, settings.time_box_ms, settings.preview)
