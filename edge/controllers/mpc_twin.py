"""Offset-free model predictive control over the bundle's twin, with a Kalman filter for its state and
disturbance.

The disturbance is heat into the air that the twin does not know, a random walk, so that a plan which adds it
has no steady-state error (offset-free MPC: Pannocchia and Rawlings, AIChE J. 49(2), 2003).
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from edge.controllers.mixed_integer.problem import PlanningProblem
from edge.controllers.mpc import LIMIT_WEIGHT, binding, cost_split, first_command, planned_inputs, runner_up
from edge.controllers.twin_plan.beam import BeamResult, PlanStart, relay, search
from edge.controllers.twin_plan.linear_step import LinearStep, linear_step
from edge.controllers.twin_plan.rest import AHEAD_STEPS, LONGEST_STEPS, coast_steps, price, step_down
from edge.core.controller import Context, ControlLimits, Floats, goal_ahead
from edge.core.errors import DataError
from edge.core.messages import Decision
from edge.core.names import HEATER_LEVELS, levels_allowed
from edge.models.pbm import Pbm
from edge.twin.filter import expectation, predict, symmetric, update
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.signals import Conditions
from edge.twin.warm_start import at_rest, hold, spread

# A reading is the mean of several samples, most of them the same where the air is slow. Steps of 0.5 K that
# are taken for the air's own make the fan chase each of them.
MEASUREMENT_SD_K, SD_OF_STEP = 0.05, 0.5
BODY_SD_K = 0.02  # what each temperature does in a step that the twin does not know, by chance
ELEMENT_SD = 0.005  # the same of the element's heat, share of its power
DISTURBANCE_SD_K = 0.02  # how far the disturbance wanders in a step [K/step]
DISTURBANCE_START_K = 0.3  # how far it may be off when nothing is known [K/step]
CLIP_SD = 3.0  # an open door is no disturbance to learn: beyond this an innovation teaches it no more
USUAL_SURPRISE = 2.0  # a squared innovation by its variance, 1 in the mean where the twin fits
MISFIT_RATE = 0.1  # so ten steps of surprises beyond the clip make a factor of a thousand
MISFIT_MAX = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """State and disturbance at a time.

    state : [n], in the twin's order; disturbance : heat into the air, as what it alone would warm it [K/step]
    covariance : [n + 1, n + 1], the disturbance last
    misfit : by which the variance of what a step does by chance is larger than in a box that the twin fits
    """

    time_s: float
    state: Floats
    disturbance: float
    covariance: Floats
    misfit: float = 1.0


@dataclass(frozen=True, slots=True)
class StepInputs:
    """Inputs of a step and of the one before. duty : 0..1; fan : share of the step; ambient [°C]"""

    duty: float
    fan: float
    duty_before: float
    fan_before: float
    ambient: float


def begin(twin: BoxTwin, time_s: float, temp: float, ambient: float) -> Belief:
    """At rest at the first temperature that is known [°C]."""
    sds = np.append(spread(twin), DISTURBANCE_START_K)
    return Belief(time_s, at_rest(twin, temp, ambient), 0.0, np.diag(sds**2))


def move_belief(belief: Belief, twin: BoxTwin, step: LinearStep, inputs: StepInputs, time_s: float) -> Belief:
    """One step on."""
    mode = step.mode(np.array(int(inputs.fan_before >= 1.0)), np.array(step.place_of(inputs.fan)))
    matrix, heat = step.matrix[mode], step.heat[mode]
    state = matrix @ belief.state + step.constant[mode] + step.room[mode] * inputs.ambient
    state += step.now[mode] * step.share_of(inputs.duty)
    state += step.late[mode] * step.share_of(inputs.duty_before) + heat * belief.disturbance
    size = len(state)
    transition = np.zeros((size + 1, size + 1))
    transition[:size, :size], transition[:size, size], transition[size, size] = matrix, heat, 1.0
    element_w = ELEMENT_SD * twin.geometry.heater_max_w
    sds = [element_w if name == HEATER else BODY_SD_K for name in twin.states]
    noise = belief.misfit * np.diag(np.square([*sds, DISTURBANCE_SD_K]))
    covariance = predict(belief.covariance, transition, noise)
    return replace(belief, time_s=time_s, state=state, covariance=covariance)


def measurement_sd_k(twin: BoxTwin) -> float:
    """Return how far a reading may be off by chance and by the steps of the sensor."""
    return max(MEASUREMENT_SD_K, SD_OF_STEP * twin.noise.step_k)


def correct_belief(belief: Belief, measured: float, shown: int, sensor_k: float = MEASUREMENT_SD_K) -> Belief:
    """By a measurement [°C] of the state `shown`; one that is no number teaches nothing.

    sensor_k : its standard deviation

    Innovations larger than expected, one after the other, widen what a step may do by chance (covariance
    matching: Mehra, IEEE Trans. Autom. Control 17(5), 1972), so that a poor twin follows its box too.
    """
    if not np.isfinite(measured):
        return belief
    widened = np.append(belief.state, belief.disturbance)
    innovation, variance = expectation(widened, belief.covariance, measured, sensor_k**2, shown)
    surprise = min(innovation**2 / variance, CLIP_SD**2) - USUAL_SURPRISE
    misfit = min(max(belief.misfit * math.exp(MISFIT_RATE * surprise), 1.0), MISFIT_MAX)
    mean, covariance = update(widened, belief.covariance, measured, sensor_k**2, shown, clip_sd=CLIP_SD)
    return replace(
        belief,
        state=mean[:-1],
        disturbance=float(mean[-1]),
        covariance=symmetric(covariance),
        misfit=misfit,
    )


HORIZON = 20  # steps; the heater's element answers for five minutes, a step down needs the fan for three
TAIL = 10
WIDTH = 300  # of the beam: so many kinds of nodes there are, dear ones too, that pay off at a step
# On the effort of `MPC-Twin`: of two plans that track alike the one that spends less. Alike is what noise
# hides: full effort for a step costs as much as an error of 0.05 K.
LEAST_WEIGHT = 0.03


FAN_PARTS_S = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0)  # for which the fan may be on in a step


def fan_shares(step_s: float, limits: ControlLimits) -> tuple[float, ...]:
    """Return the shares of a step for which a plan may let the fan run, from 0 to 1."""
    parts = (part for part in FAN_PARTS_S if limits.fan_part_s <= part < step_s)
    return (0.0, *(part / step_s for part in parts), 1.0)


EARLY_K = 0.3  # what a plant or a person would not notice
EARLY_WEIGHT = 1e4  # 0.1 K more costs as much as 3 K off the reference for a step
LEAST_SLOPE = 0.2  # of the first level's, that the heat of any level grows by
STEP_K = 0.6  # a larger change of the reference at once is a step, a smaller one part of a ramp
SETTLING_STEPS = 10  # after a step of the reference
# Heat that is fanned out again is an error of twin or sensor: the fan waits, but for air far too warm.
CYCLE_S, CYCLE_DUTY, FAR_K = 600.0, 0.5, 1.0
CLASH_WEIGHT = 50.0  # full heat for a step against the fan costs as much as 2.2 K off the reference


def band_before_steps(reference: Floats, early_k: float, since: int, out_k: float) -> tuple[Floats, Floats]:
    """Return the lowest and the highest air [N] while a step is still to come [°C].

    No bound where no step comes, and while the air may still be on its way after the step before.
    since : steps since that one, before the first of `reference`
    out_k : of the air now, over the reference: what noise took out may come back by half of it a step
    """
    low, high = np.full(len(reference), -np.inf), np.full(len(reference), np.inf)
    is_step = np.abs(np.diff(reference, prepend=reference[0])) > STEP_K
    last = np.flatnonzero(is_step).max(initial=0)
    back = out_k * 0.5 ** np.arange(1.0, last + 1.0)
    low[:last] = reference[:last] + np.minimum(back, -early_k)
    high[:last] = reference[:last] + np.maximum(back, early_k)
    for k, steps in enumerate(is_step):
        since = 0 if steps else since + 1
        if since <= SETTLING_STEPS:
            low[k], high[k] = -np.inf, np.inf
    return low, high


def wait_after_heat(history: Mapping[str, Floats], step_s: float) -> int:
    """Return the steps until a start of the fan is no cycle with the last one and strong heat since then.

    history : `heater_duty` and `fan_on` of past steps, as `Context.history`
    """
    rows = round(CYCLE_S / step_s)
    duty, fan = (np.nan_to_num(history[name][-rows - 1 :]) for name in ("heater_duty", "fan_on"))
    starts = np.flatnonzero((fan[1:] > 0.0) & ~(fan[:-1] >= 1.0)) + 1
    if not len(starts) or duty[starts[-1] :].max() < CYCLE_DUTY:
        return 0
    return max(rows + 1 - (len(fan) - int(starts[-1])), 0)


class MpcTwin:
    """`MPC-Twin` and `MPC-Twin-P`. The controller follows the twin's state from tick to tick.

    preview : plan for the coming reference, else for the present one
    early_k : the air leaves the reference by no more before a step of it is due [K]
    """

    def __init__(
        self, name: str, model: Pbm, weight: float, preview: bool = True, early_k: float = EARLY_K
    ) -> None:
        self.name = name
        self._model = model
        self._twin = model.twin
        self._weight = max(weight, LEAST_WEIGHT)
        self._preview = preview
        self._early_k = early_k
        self._belief: Belief | None = None
        self._step: LinearStep | None = None
        self._since, self._last_reference = 0, math.nan
        self._rested = 0  # steps of a rest under way

    def reset(self) -> None:
        """Forget the state: the next decision finds it from the whole history."""
        self._belief = None
        self._since, self._last_reference = 0, math.nan
        self._rested = 0

    def decide(self, context: Context) -> Decision:
        """Return the first step of the cheapest plan found. Errors: DataError of twin or problem"""
        begun = time.perf_counter()
        belief, step = self._follow(context)
        reference = _held_from_tail(goal_ahead(context, HORIZON + TAIL, self._preview))
        before = self._last_reference
        goal = self._goal(context, reference, self._steps_since(float(reference[0])))
        last = context.last_sent
        level = round(last.heater_duty * HEATER_LEVELS)
        start = PlanStart(
            belief.state, belief.disturbance, context.estimate.temp_ambient, level, int(last.fan_at_end),
            context.limits.fan_starts,
        )  # fmt: skip
        goal, found = self._with_rest(context.limits.proof_in_steps, before, goal, step, start)
        plan = found.plan
        why = {
            **cost_split(goal, plan.levels / HEATER_LEVELS, plan.fan, _padded_air(found, goal)),
            "nodes": found.nodes,
            "binding": binding(goal, plan, found.air),
            "runner_up": runner_up(plan, found.runner_up),
            "reference_c": goal.reference[: goal.horizon].tolist(),
            "disturbance_k": belief.disturbance,
            "model": f"{self._model.name} {self._model.version}",
            "solve_ms": round(1e3 * (time.perf_counter() - begun), 3),
        }
        return Decision(first_command(plan), self.name, tuple(found.air.tolist()), why, planned_inputs(plan))

    def _with_rest(
        self, due: int | None, before: float, goal: PlanningProblem, step: LinearStep, start: PlanStart
    ) -> tuple[PlanningProblem, BeamResult]:
        """Return goal and plan, with a rest for the relay's proof where one is due or comes cheaper now.

        due : steps until the supervisor asks for it; before : the last decision's reference [°C]
        """
        if due is None or due > AHEAD_STEPS:
            self._rested = 0
            return goal, search(step, goal, start, WIDTH)
        steps = coast_steps(step, start.state, start.ambient, start.disturbance)

        def rest_from(begin: int) -> tuple[PlanningProblem, BeamResult]:
            rest = replace(goal, rest=range(begin, begin + steps))
            return rest, search(step, rest, start, WIDTH)

        if 0 < self._rested < LONGEST_STEPS:  # one begun is not broken off
            self._rested += 1
            return rest_from(0)
        self._rested, free = 0, search(step, goal, start, WIDTH)
        offered = step_down(goal.reference[: goal.horizon], before)
        for begin, most in ((offered, free.plan.cost + price(steps)), (due, math.inf)):
            if begin is not None and begin <= min(due, goal.horizon - 1):
                rest, found = rest_from(begin)
                if found.plan.cost <= most:
                    self._rested = int(begin == 0)
                    return rest, found
        return goal, free

    def _steps_since(self, now: float) -> int:
        """Return the decisions since the reference, now [°C], had a step; after a reset it counts as one."""
        is_step = not abs(now - self._last_reference) <= STEP_K
        self._since, self._last_reference = 0 if is_step else self._since + 1, now
        return self._since

    def _goal(self, context: Context, reference: Floats, since: int) -> PlanningProblem:
        """Return a plan's goal and limits, without the response, which the twin gives."""
        limits, asked, weight = context.limits, context.penalty, self._weight
        nothing: Floats = np.zeros(len(reference))
        out_k = float(context.history["temp_air"][-1] - reference[0])
        low, high = band_before_steps(reference, self._early_k, since, out_k)
        # A step of the reference, just now or in the plan, may ask for both.
        is_level = since > SETTLING_STEPS and not np.isfinite(low).any()
        far_k = min(FAR_K, limits.temp_air_max_c - float(reference[0]))
        is_free = context.last_sent.fan_at_end or not is_level or out_k > far_k
        wait = 0 if is_free else wait_after_heat(context.history, context.step_s)
        return PlanningProblem(
            free=nothing,
            heater=nothing,
            fan=nothing,
            reference=reference,
            tail=TAIL,
            heater_weight=weight if asked.heater is None else max(asked.heater, LEAST_WEIGHT),
            fan_weight=weight if asked.fan is None else max(asked.fan, LEAST_WEIGHT),
            heater_levels=levels_allowed(limits.heater_max_duty),
            fan_rules=relay(
                context.last_sent.fan_at_end,
                max(limits.fan_hold_steps, wait),
                limits.fan_min_on_steps,
                limits.fan_min_off_steps,
                HORIZON,
            ),
            temp_max=limits.temp_air_max_c,
            limit_weight=LIMIT_WEIGHT,
            low=low,
            high=high,
            band_weight=EARLY_WEIGHT,
            clash_weight=CLASH_WEIGHT,
        )

    def _follow(self, context: Context) -> tuple[Belief, LinearStep]:
        """Estimate the present state, from the last tick's or from the whole history."""
        history = context.history
        rows = len(history["temp_air"])
        measured = history.get("temp_air_measured", history["temp_air"])
        times = context.now_s - context.step_s * np.arange(rows - 1, -1, -1)
        belief = self._belief
        last = -1 if belief is None else int(np.argmin(np.abs(times - belief.time_s)))
        if belief is None or not abs(times[last] - belief.time_s) < 0.5 * context.step_s:
            known = np.flatnonzero(np.isfinite(measured))
            if not len(known):
                raise DataError("history: no air temperature is known")
            last = int(known[0])
            belief = begin(
                self._twin, times[last], float(measured[last]), float(history["temp_ambient"][last])
            )
        step, sensor_k = self._linear(belief, context), measurement_sd_k(self._twin)
        for row in range(last, rows - 1):
            belief = move_belief(belief, self._twin, step, _inputs(context, row), float(times[row + 1]))
            belief = correct_belief(belief, float(measured[row + 1]), step.shown, sensor_k)
        self._belief = belief
        return belief, step

    def _linear(self, belief: Belief, context: Context) -> LinearStep:
        """Linearise the twin's step at the present state; a linear twin always has the same."""
        if self._step is None or self._twin.signals.bends or self._twin.needs:
            now: Conditions = {name: hold(context.history[name])[-1:] for name in self._twin.needs}
            room, fans = context.estimate.temp_ambient, fan_shares(context.step_s, context.limits)
            step = linear_step(self._twin, belief.state, room, now, fans)
            self._step = replace(step, share=never_flat(step.share))
        return self._step


def never_flat(share: Floats) -> Floats:
    """Return the heat of each level so that each gives more than the one below it.

    A twin that takes a heater's droop for saturation would let a cold box wait below full heat.
    """
    least = LEAST_SLOPE * (share[1] - share[0]) * np.arange(len(share))
    return np.asarray(np.maximum.accumulate(share - least) + least)


def _inputs(context: Context, row: int) -> StepInputs:
    """Return the inputs of the step that begins at a row of the history; unknown ones count as off."""
    history, before = context.history, max(row - 1, 0)
    duty, fan = np.nan_to_num(history["heater_duty"]), np.nan_to_num(history["fan_on"])
    ambient = float(history["temp_ambient"][row])
    return StepInputs(float(duty[row]), float(fan[row]), float(duty[before]), float(fan[before]), ambient)


def _held_from_tail(reference: Floats) -> Floats:
    """Return the reference [N] without a step in the tail, whose one heat cannot serve both sides of it."""
    steps = HORIZON + np.flatnonzero(np.abs(np.diff(reference[HORIZON - 1 :])) > STEP_K)
    if len(steps):
        reference = reference.copy()
        reference[steps[0] :] = reference[steps[0] - 1]
    return reference


def _padded_air(found: BeamResult, goal: PlanningProblem) -> Floats:
    """Air over horizon and tail; over the tail as if the reference were met, so that it costs nothing."""
    return np.concatenate([found.air, goal.reference[goal.horizon :]])
