"""Belief about a twin's state from tick to tick: a Kalman filter that also estimates a disturbance.

The disturbance is heat into the air that the twin does not know, a random walk, so that a plan which adds it
has no steady-state error (offset-free MPC: Pannocchia and Rawlings, AIChE J. 49(2), 2003).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.controllers.twin_plan.linear_step import LinearStep
from edge.twin.filter import predict, symmetric, update
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]
MEASUREMENT_SD_K = 0.05  # a reading is the mean of several samples in steps of 0.1 K
BODY_SD_K = 0.02  # what each temperature does in a step that the twin does not know, by chance
ELEMENT_SD = 0.005  # the same of the element's heat, share of its power
DISTURBANCE_SD_K = 0.02  # how far the disturbance wanders in a step [K/step]
DISTURBANCE_START_K = 0.3  # how far it may be off when nothing is known [K/step]
CLIP_SD = 3.0  # an open door is no disturbance to learn: beyond this an innovation teaches it no more


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """State and disturbance at a time.

    state : [n], in the twin's order; disturbance : heat into the air, as what it alone would warm it [K/step]
    covariance : [n + 1, n + 1], the disturbance last
    """

    time_s: float
    state: Floats
    disturbance: float
    covariance: Floats


@dataclass(frozen=True, slots=True)
class StepInputs:
    """Inputs of a step and of the one before. duty : 0..1; fan : 0 or 1; ambient [°C]"""

    duty: float
    fan: int
    duty_before: float
    fan_before: int
    ambient: float


def begin(twin: BoxTwin, time_s: float, temp: float, ambient: float) -> Belief:
    """At rest at the first temperature that is known [°C]."""
    sds = np.append(spread(twin), DISTURBANCE_START_K)
    return Belief(time_s, at_rest(twin, temp, ambient), 0.0, np.diag(sds**2))


def move_belief(belief: Belief, twin: BoxTwin, step: LinearStep, inputs: StepInputs, time_s: float) -> Belief:
    """One step on."""
    mode = 2 * inputs.fan_before + inputs.fan
    matrix, heat = step.matrix[mode], step.heat[mode]
    state = matrix @ belief.state + step.constant[mode] + step.room[mode] * inputs.ambient
    state += step.now[mode] * step.share_of(inputs.duty)
    state += step.late[mode] * step.share_of(inputs.duty_before) + heat * belief.disturbance
    size = len(state)
    transition = np.zeros((size + 1, size + 1))
    transition[:size, :size], transition[:size, size], transition[size, size] = matrix, heat, 1.0
    element_w = ELEMENT_SD * twin.geometry.heater_max_w
    sds = [element_w if name == HEATER else BODY_SD_K for name in twin.states]
    noise = np.diag(np.square([*sds, DISTURBANCE_SD_K]))
    covariance = predict(belief.covariance, transition, noise)
    return replace(belief, time_s=time_s, state=state, covariance=covariance)


def correct_belief(belief: Belief, measured: float, shown: int) -> Belief:
    """By a measurement [°C] of the state `shown`; one that is no number teaches nothing."""
    if not np.isfinite(measured):
        return belief
    widened = np.append(belief.state, belief.disturbance)
    mean, covariance = update(
        widened, belief.covariance, measured, MEASUREMENT_SD_K**2, shown, clip_sd=CLIP_SD
    )
    return replace(belief, state=mean[:-1], disturbance=float(mean[-1]), covariance=symmetric(covariance))
