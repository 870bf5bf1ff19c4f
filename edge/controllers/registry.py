"""Controllers by their public names."""

from edge.config_schema import nearest
from edge.controllers.base import Controller
from edge.controllers.mpc import Mpc, MpcSettings
from edge.controllers.rules import Rules
from edge.errors import RequestError
from edge.models.arx import Arx
from edge.models.base import Predictor
from edge.settings import CONTROLLERS, ControlSettings


def make(
    name: str, settings: ControlSettings, model: Predictor, linear: Predictor | None = None
) -> Controller:
    """The controller called `name`.

    linear : the ARX model whose plan a search over another `model` begins with
    Raises : RequestError for a name there is not, with the nearest one
    """
    if name not in CONTROLLERS:
        raise RequestError(f"controller: there is no {name!r}; {nearest(name, CONTROLLERS)}")
    if name == "rules":
        return Rules()
    arx = model if linear is None else linear
    if not isinstance(arx, Arx):
        raise RequestError(f"{name}: plans with an ARX model, not with {arx.name} {arx.version}")
    weight = 1.0 if name.endswith("-P") else 0.0
    if name.startswith("MPC-BFGS"):
        from edge.controllers.mpc_bfgs import MpcBfgs  # late: the daemon rarely needs it

        return MpcBfgs(name, arx, weight, settings.horizon)
    mpc = MpcSettings(
        weight=weight,
        horizon=settings.horizon,
        node_budget=settings.node_budget,
        time_box_s=1e-3 * settings.time_box_ms,
        preview=settings.preview,
        tail=settings.tail,
    )
    if model is arx:
        return Mpc(name, arx, mpc)
    from edge.controllers.mpc_rollout import MpcRollout  # late: most rigs plan with the ARX

    return MpcRollout(name, model, arx, mpc, settings.rollout_budget)
