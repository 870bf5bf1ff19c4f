"""Controllers by their public names."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edge.assistant.llm.language_model import LanguageModel
from edge.config.settings import ControlSettings
from edge.controllers.mpc import Mpc, MpcSettings
from edge.controllers.pid import Pid
from edge.controllers.rl import Rl
from edge.controllers.rules import Rules
from edge.core import controller_names as names
from edge.core.controller import Controller
from edge.core.errors import RequestError
from edge.core.predictor import Predictor
from edge.formats.cross_check import nearest
from edge.models.arx import Arx
from edge.models.onnx_policy import OnnxPolicy
from edge.models.pbm import Pbm


@dataclass(frozen=True, slots=True)
class ControllerParts:
    """The parts that controllers are made from.

    model : estimates, and MPC and MPC-P plan with it
    linear : the ARX model whose plan a search over another `model` begins with
    predictors : of the active bundle, by name
    llm : None where none is configured
    policies : of the active bundle, by the controller that they are for
    """

    control: ControlSettings
    model: Predictor
    linear: Predictor | None = None
    predictors: Mapping[str, Predictor] = field(default_factory=dict)
    llm: LanguageModel | None = None
    policies: Mapping[str, OnnxPolicy] = field(default_factory=dict)


def make(name: str, parts: ControllerParts) -> Controller:
    """Make the controller called `name`. Raises : RequestError for an unknown name, with the nearest one"""
    if name not in names.CONTROLLERS:
        raise RequestError(f"controller: there is no {name!r}; {nearest(name, names.CONTROLLERS)}")
    if name == names.RULES:
        return Rules()
    if name in names.MPC:
        return _mpc(name, parts)
    if name in names.LLM:
        return _llm(name, parts)
    if name in parts.policies:
        return Rl(name, parts.policies[name])
    if name == names.PID:
        return Pid()
    if name in names.MPC_TWIN:
        return _mpc_twin(name, parts)
    raise RequestError(f"controller: {name} needs a model that is missing here")


def _mpc_twin(name: str, parts: ControllerParts) -> Controller:
    from edge.controllers.mpc_twin import MpcTwin  # late: only a rig with a twin has it

    model = parts.predictors.get("pbm")
    if not isinstance(model, Pbm):
        raise RequestError(f"{name}: plans with the twin of the active bundle, there is none")
    control = parts.control
    return MpcTwin(name, model, control.effort_weight(name), control.twin_preview, control.twin_early_k)


def _mpc(name: str, parts: ControllerParts) -> Controller:
    settings, model = parts.control, parts.model
    arx = model if parts.linear is None else parts.linear
    if not isinstance(arx, Arx):
        raise RequestError(f"{name}: plans with an ARX model, not with {arx.name} {arx.version}")
    weight = settings.effort_weight(name)
    if name.startswith("MPC-BFGS"):
        from edge.controllers.mpc_bfgs import MpcBfgs  # late: the daemon rarely needs it

        return MpcBfgs(name, arx, weight, settings.horizon, settings.preview)
    mpc = MpcSettings(
        weight=weight,
        horizon=settings.horizon,
        node_budget=settings.node_budget,
        time_box_s=1e-3 * settings.time_box_ms,
        decision_s=settings.decision_deadline_s,
        preview=settings.preview,
        tail=settings.tail,
    )
    if model is arx:
        return Mpc(name, arx, mpc)
    from edge.controllers.mpc_rollout import MpcRollout  # late: most rigs plan with the ARX

    return MpcRollout(name, model, arx, mpc, settings.rollout_budget)


def _llm(name: str, parts: ControllerParts) -> Controller:
    from edge.assistant.llm.controller import LlmController  # late: most rigs have no language model
    from edge.assistant.llm.proposal import Architecture

    if parts.llm is None:
        raise RequestError(f"{name}: no language model is configured")
    control, variant = parts.control, names.LLM[name]
    predictor, missing = _assisting(variant.assistance, parts)
    estimates = predictor is not None and predictor is parts.model
    architecture = Architecture(variant, predictor, estimates, control.horizon, control.preview)
    deadline_s = min(control.decision_deadline_s, control.step_s / 2)
    return LlmController(name, parts.llm, architecture, deadline_s, missing)


def _assisting(assistance: str, parts: ControllerParts) -> tuple[Predictor | None, str]:
    """Return the predictor that a variant simulates with, and the reason if a required one is missing."""
    if assistance in ("", "sql"):
        return None, ""
    if assistance == "arx":
        return parts.model if parts.linear is None else parts.linear, ""
    predictor = parts.predictors.get(assistance)
    return predictor, "" if predictor else f"there is no {assistance} in the active bundle"
