"""The predictive models of a daemon: the configured one, or the active bundle, changed between ticks."""

from collections.abc import Mapping
from pathlib import Path

from edge.app import controllers as registry
from edge.assistant.llm.language_model import LanguageModel
from edge.bundle.keeper import BundleKeeper, Serving
from edge.bundle.manifest import PACKAGED
from edge.bundle.store import LoadedBundle
from edge.bundle.trial import rival_rows
from edge.config.settings import ControlSettings, Settings
from edge.core.controller import Controller
from edge.core.controller_names import AUTO, EXTERNAL, MPC, MPC_TWIN, NEED_A_MODEL, NEED_NO_MODEL, RL
from edge.core.errors import ConfigError
from edge.core.messages import Command, Decision
from edge.core.predictor import Columns, Predictor
from edge.forecasts.conformal import Intervals
from edge.forecasts.forecasting import Forecasting
from edge.forecasts.skill import SkillState
from edge.models.arx import Arx
from edge.models.arx_file import DEFAULT_PATH, read_arx
from edge.models.pbm import Pbm
from edge.models.persistence import Persistence
from edge.tick.estimator import Estimator
from edge.tick.rig import Forecasts
from edge.twin.model import BoxTwin


def configured_model(control: ControlSettings) -> Predictor:
    """Return the ARX model of `control.model`, else the packaged one. A rig
    that runs by rules alone needs neither.

    Errors : ConfigError when the model is made for another step than `control.step_s`; DataError by its file
    """
    model = read_arx(Path(control.model) if control.model else DEFAULT_PATH)
    if model.step_s == control.step_s:
        return model
    if not control.model and control.controller in NEED_NO_MODEL:
        return Persistence(control.step_s)
    raise ConfigError(
        f"control.model: {control.model or 'the packaged model'} is made for steps of {model.step_s:g} s, "
        f"control.step_s is {control.step_s:g}: fit one to recorded runs with "
        f"`greenhouse fit-arx --step-s {control.step_s:g}`, or use the controller `rules`"
    )


class ActiveModels:
    """Which model estimates and plans, and which only forecast.

    With a bundle the model `control.predictor` of it; with `control.model` that ARX file; with neither the
    packaged ARX.
    """

    def __init__(
        self,
        settings: Settings,
        keeper: BundleKeeper | None,
        state: SkillState,
        llm: LanguageModel | None = None,
    ) -> None:
        """Errors: ConfigError where no model fits the configured step and a controller needs one."""
        self._names = [name for name in settings.controllers if name != EXTERNAL]  # made of no model
        control = self._control = settings.control
        self._keeper = keeper
        self._llm = llm
        self._configured = configured_model(control) if keeper is None or control.model else None
        self._serving = None if keeper is None else keeper.serving
        self.model, self.linear = self._choose()
        if control.controller in MPC_TWIN and self.twin is None:
            raise ConfigError(
                f"control.controller: {control.controller} plans with a bundle's twin, there is none"
            )
        active, intervals, rivals = self._forecasting_parts()
        self.forecasting = Forecasting(control.step_s, active, intervals, rivals, state)

    @property
    def twin(self) -> BoxTwin | None:
        """The active bundle's; None where it has no physics model."""
        model = _active(self._serving).get("pbm")
        return model.twin if isinstance(model, Pbm) else None

    def first_controller(self) -> tuple[str, str]:
        """Return who controls a rig on which nobody has chosen, and why.

        The packaged twin is of another box, so MPC-Twin-P is for a bundle that was installed.
        """
        if self._control.controller != AUTO:
            return self._control.controller, "control.controller"
        bundle = _bundle(self._serving)
        if bundle is not None and bundle.name != PACKAGED and self.twin is not None:
            return MPC_TWIN[-1], f"bundle {bundle.name} has a twin"
        return MPC[1], "no bundle with a twin of this rig is active"

    def controllers(self) -> dict[str, Controller]:
        """All that can decide with these models, by name."""
        bundle = _bundle(self._serving)
        policies = {} if bundle is None else bundle.policies
        predictors = _active(self._serving)
        parts = registry.ControllerParts(
            self._control, self.model, self.linear, predictors, policies=policies, llm=self._llm
        )
        without = NEED_A_MODEL if isinstance(self.model, Persistence) else ()
        without = (*without, *(name for name in RL if name not in policies))
        if self.twin is None:
            without = (*without, *MPC_TWIN)
        return {name: registry.make(name, parts) for name in self._names if name not in without}

    def versions(self) -> dict[str, str]:
        """Return the version of every model that forecasts."""
        return {name: model.version for name, model in self._forecasting_parts()[0].items()}

    def exchange(self, estimator: Estimator, controllers: dict[str, Controller]) -> str:
        """Take what the keeper serves now, between two ticks, without a bump; what was done, in words."""
        if self._keeper is None or self._keeper.serving is self._serving:
            return ""
        active_before, before = _bundle(self._serving), self.model
        self._serving = self._keeper.serving
        kept = ""
        try:
            self.model, self.linear = self._choose()
        except ConfigError as error:
            kept = f"; {error}: the one before goes on"
        self.forecasting.serve(*self._forecasting_parts())
        if self.model != before:
            estimator.set_model(self.model)
        if _bundle(self._serving) is not active_before:  # a new shadow is none of the controllers' business
            own = self.controllers()
            for name in set(self._names) & (controllers.keys() - own):  # their model left with the bundle
                del controllers[name]
            controllers.update(own)
        return f"{self.model.name} {self.model.version} estimates and plans{kept}"

    def begin_anew(self) -> None:
        """As `Forecasting.begin_anew`."""
        self.forecasting.begin_anew()

    def forecast(self, history: Columns, decision: Decision, driven: Command, confirmed: bool) -> Forecasts:
        """As `Forecasting.tick`; a bundle on trial is judged by the scores."""
        made = self.forecasting.tick(history, decision, driven, confirmed)
        serving = self._serving
        if self._keeper is not None and serving is not None and serving.active and serving.rival:
            state, active, rival = self.forecasting.state, serving.active.predictors, serving.rival.predictors
            self._keeper.consider(serving, rival_rows(state, active, rival))
        return made

    def _choose(self) -> tuple[Predictor, Predictor]:
        """Return the model that estimates and plans, and the linear one that proposes plans to it."""
        if self._configured is not None:
            return self._configured, self._configured
        active = _active(self._serving)
        linear = active.get("arx") or configured_model(self._control)
        if self._control.predictor == "arx":
            return linear, linear
        model = active.get(self._control.predictor)
        if model is None:
            raise ConfigError(f"control.predictor: {self._control.predictor} is not in the active bundle")
        if not isinstance(linear, Arx):
            raise ConfigError(
                f"control.predictor: {model.name} plans from an ARX model's plan, there is none"
            )
        return model, linear

    def _forecasting_parts(self) -> tuple[Mapping[str, Predictor], Intervals, Mapping[str, Predictor]]:
        serving = self._serving
        if serving is None or serving.active is None:
            alone = {} if isinstance(self.model, Persistence) else {self.model.name: self.model}
            return alone, Intervals(), {}
        active = dict(serving.active.predictors)
        if self._configured is not None and not isinstance(self._configured, Persistence):
            active["arx"] = self._configured
        rivals = {} if serving.rival is None else serving.rival.predictors
        return active, serving.active.intervals, rivals


def _active(serving: Serving | None) -> Mapping[str, Predictor]:
    bundle = _bundle(serving)
    return {} if bundle is None else bundle.predictors


def _bundle(serving: Serving | None) -> LoadedBundle | None:
    """Return the active bundle."""
    return None if serving is None else serving.active
