"""Context of a controller at a tick: history, estimate, reference ahead, limits, an operator's requests."""

from dataclasses import dataclass

from edge.core.controller import Columns, Context, ControlLimits, Penalty
from edge.core.messages import Command, Estimate
from edge.tick.orders import Operation
from edge.tick.reference import Reference
from edge.tick.steering import in_force, limit, penalty_of

REFERENCE_STEPS = 120  # how far ahead controllers may see the reference [steps]


@dataclass(frozen=True, slots=True)
class TickTime:
    """When a tick is, by every clock that counts [s]."""

    now_s: float
    utc: float
    since_start_s: float  # of the configured reference: the axis of one that is not daily
    since_midnight_s: float  # local
    step_s: float


def context_of(
    moment: TickTime,
    operation: Operation,
    configured: Reference,
    history: Columns,
    estimate: Estimate,
    last_sent: Command,
    limits: ControlLimits,
) -> Context:
    """Return the context of this tick. limits : those of the safety supervisor"""
    steering = operation.steering_at(moment.utc)
    penalty = Penalty()
    if operation.profile is not None:
        configured = operation.profile.reference(moment.since_start_s)
    reference = in_force(operation.reference_c, steering, configured)
    # A request may narrow what the supervisor allows, never widen it.
    if steering is not None:
        limits = limit(limits, steering, moment.since_midnight_s, moment.step_s, last_sent.fan_at_end)
        penalty = penalty_of(steering)
    return Context(
        now_s=moment.now_s,
        utc=moment.utc,
        step_s=moment.step_s,
        history=history,
        estimate=estimate,
        reference=reference.ahead(
            moment.since_start_s, moment.since_midnight_s, moment.step_s, REFERENCE_STEPS
        ),
        last_sent=last_sent,
        limits=limits,
        penalty=penalty,
    )
