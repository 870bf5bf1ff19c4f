"""The project's own controllers that need no model, to compare with: `rules` and `PID`."""

import math

import numpy as np

from edge.controllers.pid import Pid
from edge.controllers.rules import Rules
from edge.core.controller import Context, Controller, ControlLimits
from edge.core.controller_names import PID, RULES
from edge.core.errors import RequestError
from edge.core.messages import Command, Estimate

MAKERS = {RULES: Rules, PID: Pid}


class PackagedController:
    """`rules` or `PID` as a function of what a lab shows, called once a step."""

    def __init__(self, name: str, step_s: float = 60.0) -> None:
        """Make the controller.

        step_s : from one call to the next [s]
        Errors : RequestError for another name
        """
        if name not in MAKERS:
            raise RequestError(f"{name}: not a controller without a model; known: {', '.join(MAKERS)}")
        self._controller: Controller = MAKERS[name]()
        self._step_s = step_s
        self._last = Command()

    def __call__(self, time_s: float, temp_c: float, ambient_c: float, reference_c: float) -> Command:
        """Return the command of the step that begins now; temperatures in °C."""
        now = {"temp_air": temp_c, "temp_ambient": ambient_c, "heater_duty": math.nan, "fan_on": math.nan}
        context = Context(
            now_s=time_s,
            utc=time_s,
            step_s=self._step_s,
            history={name: np.array([value]) for name, value in now.items()},
            estimate=Estimate(temp_c, 0.0, 0.0, None, ambient_c, time_s),
            reference=np.array([reference_c]),
            last_sent=self._last,
            limits=ControlLimits(),
        )
        self._last = self._controller.decide(context).command
        return self._last
