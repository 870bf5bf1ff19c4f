"""Is an air sensor stuck? One that stands exactly still is, if the box (box_bounds.py) must have moved it:

- heat differs from that which held it, by more than sun, walls and the fan explain;
- full heat in a box that is warm already, which shows that the heater works, and far from its reach. Where
  that cannot be asked, for want of a room temperature or of a fitted box, strong heat for so long is enough.

A still sensor in a box as cold as its room may as well be a dead heater: that is left to thermal supervision.
"""

import math
from dataclasses import dataclass, replace

from edge.core.messages import Command
from edge.safety.box_bounds import BoxBounds

HELD_S = 300.0  # lag of the mean duty: that of a heater's element
MISSED_K = 1.0  # that the heat would have moved even the heaviest box
FULL_DUTY = 0.95  # a box that is held gets less
STRONG_DUTY = 0.5  # in a box of which nothing is known
WARM_K = 2.0  # over the room: the heater has shown that it works
LIKELY_LOSS = 0.65  # of the largest loss, which has its margin: a still sensor is a witness by itself


@dataclass(frozen=True, slots=True)
class Stillness:
    """Heat that was driven while the raw value stood still."""

    since_s: float = math.inf
    looked_s: float = math.inf
    duty: float = 0.0  # mean heater duty behind a lag of HELD_S
    held_duty: float = 0.0  # the same when the value last moved
    held_fan: float = 0.0  # share of the fan then
    changed_s: float = 0.0  # integral of duty - held_duty since then, full-duty seconds
    risen_k: float = 0.0  # by so much full heat must have warmed the air since then
    strong_s: float = 0.0  # time under heat so strong that stillness is odd in any box [s]


def watch(
    still: Stillness, since_s: float, now: float, driven: Command, excess_k: float | None, box: BoxBounds
) -> Stillness:
    """Return the stillness after one more look.

    since_s : when the raw value last moved; driven : since the last look
    excess_k : air over room, None if unknown
    """
    duty, fan = driven.heater_duty, driven.fan
    mean_duty = _mean_duty(still, now, duty)
    if since_s != still.since_s:
        still = Stillness(since_s, since_s, held_duty=mean_duty, held_fan=fan)
    still_s = max(0.0, now - still.looked_s)
    change, is_full = duty - still.held_duty, duty >= FULL_DUTY
    is_warm = excess_k is None or excess_k >= WARM_K
    explained = change * (fan - still.held_fan) > 0.0 or (change > 0.0 and not is_warm)
    rise_k_s = _least_rise_k_s(excess_k, box) if is_full and is_warm and fan == 0.0 else 0.0
    is_strong = is_full or (duty >= STRONG_DUTY and not box.is_known)
    return replace(
        still,
        looked_s=now,
        duty=mean_duty,
        changed_s=still.changed_s + (0.0 if explained else change * still_s),
        risen_k=still.risen_k + rise_k_s * still_s,
        strong_s=still.strong_s + (still_s if is_strong else 0.0),
    )


def _mean_duty(still: Stillness, now: float, duty: float) -> float:
    """Return the mean after this look; before the first one the duty was as it is."""
    if still.looked_s == math.inf:
        return duty
    passed_s = max(0.0, now - still.looked_s)
    return still.duty + (duty - still.duty) * passed_s / (HELD_S + passed_s)


def _least_rise_k_s(excess_k: float | None, box: BoxBounds) -> float:
    """Return how fast full heat warms the box at the least, 0 near its reach or if that is unknown [K/s]."""
    if excess_k is None:
        return 0.0
    return max(0.0, box.power_min_w - LIKELY_LOSS * box.loss_max_w_k * excess_k) / box.capacity_max_j_k


def is_stuck(
    still: Stillness, now: float, excess_k: float | None, box: BoxBounds, stuck_after_s: float
) -> bool:
    """Say whether the value stands still though the box must have moved it."""
    still_s = now - still.since_s
    if not still_s >= stuck_after_s:
        return False
    changed_j = box.power_min_w * abs(still.changed_s) - box.other_heat_long_w * still_s
    if changed_j >= MISSED_K * box.capacity_max_j_k:
        return True
    is_unknown = excess_k is None or not box.is_known
    strong_s = still.strong_s if is_unknown else 0.0
    return still_s >= 2.0 * stuck_after_s and (still.risen_k >= MISSED_K or strong_s >= 2.0 * stuck_after_s)
