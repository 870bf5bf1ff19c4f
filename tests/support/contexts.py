"""Contexts for controllers, and the packaged model."""

import numpy as np

from edge.core.controller import Context, ControlLimits
from edge.core.messages import Command, Estimate

OFF, FREE = Command(), ControlLimits()


def context(
    temp: float = 24.0,
    reference: float | list[float] = 26.0,
    last_sent: Command = OFF,
    limits: ControlLimits = FREE,
    offset: float = 0.0,
    now_s: float = 0.0,
    rows: int = 10,  # more than a packaged model looks back
) -> Context:
    """A box that has stood at `temp` for `rows` ticks with the inputs last sent, in a room of 21 °C."""
    inputs = np.full(rows, last_sent.heater_duty), np.full(rows, float(last_sent.fan_on))
    for values in inputs:
        values[-1] = np.nan
    targets = np.full(60, reference) if isinstance(reference, float) else np.array(reference)
    return Context(
        now_s=now_s,
        utc=1.7e9 + now_s,
        step_s=60.0,
        history={
            "temp_air": np.full(rows, temp),
            "temp_ambient": np.full(rows, 21.0),
            "heater_duty": inputs[0],
            "fan_on": inputs[1],
        },
        estimate=Estimate(temp, 0.1, offset, 0.0, 21.0, now_s),
        reference=targets,
        last_sent=last_sent,
        limits=limits,
    )
