"""The paper's way to solve the same equations: SciPy's RK45 over each step. Slow; to compare with."""

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.model import BoxTwin

Floats = NDArray[np.float64]
SCIPY_RTOL, SCIPY_ATOL = 1e-3, 1e-6  # scipy's defaults, which the paper's text leaves as they are


def rk45_rollout(
    twin: BoxTwin,
    start: Floats,
    duty: Floats,
    fan: Floats,
    ambient: Floats,
    source: float = 0.0,
    rtol: float = SCIPY_RTOL,
    atol: float = SCIPY_ATOL,
) -> Floats:
    """States after each step, integrated step by step because the inputs jump between steps.

    start : [n]; duty, fan, ambient : [N]
    Returns : [N, n]
    Errors : DataError for a twin whose inputs do not act as they are
    """
    if not twin.signals.plain:
        raise DataError("twin: has effects on its inputs, which these equations do not hold")
    from scipy.integrate import solve_ivp

    system = twin.system
    states = np.empty((len(duty), len(start)))
    state = start
    for k in range(len(duty)):
        inputs = np.array([duty[k], ambient[k], source])
        for speed, length_s in _fan_course(twin, float(fan[k])):
            rates = system.rates + speed * system.fan_rates
            driven = (system.drive + speed * system.fan_drive) @ inputs

            # Bound as defaults: this step's values, whenever the solver calls.
            def slope(_: float, x: Floats, rates: Floats = rates, driven: Floats = driven) -> Floats:
                return rates @ x + driven

            solution = solve_ivp(slope, (0.0, length_s), state, method="RK45", rtol=rtol, atol=atol)
            state = solution.y[:, -1]
        states[k] = state
    return states


def _fan_course(twin: BoxTwin, fan: float) -> tuple[tuple[float, float], ...]:
    """Return the fan's speeds in a step, and for how long it has each [s]."""
    if twin.has_relay and 0.0 < fan < 1.0:
        return (1.0, fan * twin.step_s), (0.0, (1.0 - fan) * twin.step_s)
    return ((fan, twin.step_s),)
