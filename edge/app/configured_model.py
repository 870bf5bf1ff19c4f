"""The predictor that a configuration asks for."""

from pathlib import Path

from edge.config.settings import ControlSettings
from edge.core.controller_names import NEED_NO_MODEL
from edge.core.errors import ConfigError
from edge.core.predictor import Predictor
from edge.models.arx_file import DEFAULT_PATH, read_arx
from edge.models.persistence import Persistence


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
