"""The model of a kind in a bundle, and the heat that by this model follows a reference.

A twin of two states, air and a slow mass, in units of the heater's full power, fitted to the mean answer of
boxes of the kind. Its inverse is exact: the air is where the reference is, and the mass follows the air.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter, ss2tf

from bench.fleet_rollout.linear_boxes import STEP_S, LinearBox

Floats = NDArray[np.float64]
LEGS = ((1.0, 120), (0.0, 240), (0.5, 480), (0.0, 600))  # share of full heat, and steps
DUTY = np.repeat([share for share, _ in LEGS], [rows for _, rows in LEGS])


@dataclass(frozen=True, slots=True)
class KindModel:
    """loss : to the room; exchange : with the mass, both share of full power [1/K]; air, mass : [s/K]

    constant : heat that comes without the heater, share of full power: sun, and what bends a loss
    """

    loss: float
    exchange: float
    air: float
    mass: float
    constant: float = 0.0

    def lacking(self, share: float) -> "KindModel":
        """Return the model without a share of its loss."""
        return replace(self, loss=(1.0 - share) * self.loss)

    def step(self) -> tuple[Floats, Floats]:
        """Return matrix [2, 2] and inputs [2, 1] of a step, by the share of full power."""
        whole = np.zeros((3, 3))
        whole[0] = np.array([-self.loss - self.exchange, self.exchange, 1.0]) / self.air
        whole[1, :2] = np.array([self.exchange, -self.exchange]) / self.mass
        after = expm(STEP_S * whole)
        return after[:2, :2], after[:2, 2:]


def heat_for(models: Sequence[KindModel], reference_c: Floats, room_c: Floats) -> Floats:
    """Return the share of full power that by each box's model follows its reference [boxes, steps].

    reference_c : [boxes, steps + 1]; room_c : [boxes, steps]
    """
    loss, exchange, air, mass, constant = (
        np.array([getattr(model, name) for model in models])[:, None]
        for name in ("loss", "exchange", "air", "mass", "constant")
    )
    air_c, rise_k = reference_c[:, :-1], np.diff(reference_c, axis=1)
    keeps = np.exp(-STEP_S * exchange / mass)
    slow_c = np.empty_like(air_c)
    slow_c[:, 0] = air_c[:, 0]
    for k in range(1, air_c.shape[1]):
        slow_c[:, k] = air_c[:, k - 1] + keeps[:, 0] * (slow_c[:, k - 1] - air_c[:, k - 1])
    held = loss * (air_c - room_c) - constant
    return np.asarray(held + exchange * (air_c - slow_c) + air * rise_k / STEP_S)


def learn_model(boxes: Sequence[LinearBox], sun_w_m2: Sequence[float]) -> KindModel:
    """Fit a model to the mean answer of boxes. sun_w_m2 : mean on each box's window"""
    seen = np.mean([_answer(box) for box in boxes], axis=0)

    def miss(values: Floats) -> Floats:
        matrix, inputs = KindModel(*np.exp(values)).step()
        b, a = ss2tf(matrix, inputs, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
        return np.asarray(lfilter(np.append(b.ravel()[1:], 0.0), a, DUTY) - seen)

    loss = float(np.mean([1.0 / box.gains_k()[0] for box in boxes]))
    start = np.log([loss, loss, 1200.0 * loss, 12000.0 * loss])
    found = least_squares(miss, start, bounds=(start - 3.5, start + 3.5), max_nfev=60)
    model = replace(KindModel(*(float(value) for value in np.exp(found.x))), loss=loss)
    return replace(model, constant=float(np.mean([*map(partial(_constant, loss), boxes, sun_w_m2)])))


def _constant(loss: float, box: LinearBox, sun_w_m2: float) -> float:
    by_heat, _, by_sun = box.gains_k()
    duty, room_c, _ = box.u0
    return float(loss * (box.shown - room_c) - duty + sun_w_m2 * by_sun / by_heat)


def _answer(box: LinearBox) -> Floats:
    """Return how a box's reading leaves its rest over DUTY."""
    state, found = np.zeros(len(box.matrix)), np.empty(len(DUTY))
    for k, share in enumerate(DUTY):
        state = box.matrix @ state + box.inputs[:, 0] * share
        found[k] = box.felt @ state
    return found
