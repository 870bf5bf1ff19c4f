"""Controllers by their public names."""

from edge.config_schema import nearest
from edge.controllers.base import Controller
from edge.controllers.mpc import Mpc, MpcSettings
from edge.controllers.rules import Rules
from edge.errors import RequestError
from edge.models.base import Predictor
from edge.settings import CONTROLLERS, ControlSettings


def make(name: str, settings: ControlSettings, model: Predictor) -> Controller:
    """The controller called `name`. Raises RequestError for a name there is not, with the nearest one."""
    if name not in CONTROLLERS:
        raise RequestError(f"controller: there is no {name!r}; {nearest(name, CONTROLLERS)}")
    if name == "rules":
        return Rules()
    weight = 1.0 if name.endswith("-P") else 0.0
    if name.startswith("MPC-BFGS"):
        from edge.controllers.mpc_bfgs import MpcBfgs  # late: the daemon rarely needs it

        return MpcBfgs(name, model, weight, settings.horizon)
    mpc = MpcSettings(
        weight, settings.horizon, settings.node_budget, 1e-3 * settings.time_box_ms, settings.preview
    )
    return Mpc(name, model, mpc)
