"""Grey boxes grown term by term while they fit better: where twins of unknown rates begin."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.diagnosis.fit import BODIES, RATES, GreyBox, Terms, fit
from edge.diagnosis.grey_run import GreyRun

MOST_TERMS = 3
BETTER = 0.95  # times the error of a fit, for one more term


@dataclass(frozen=True, slots=True, eq=False)
class GreyChoice:
    """The grey box that was chosen among those that were tried. Rows that it saw do not prove its terms."""

    terms: Terms
    tried: dict[Terms, GreyBox]

    @property
    def box(self) -> GreyBox:
        """The box that was chosen."""
        return self.tried[self.terms]


def choose(runs: Sequence[GreyRun], step_s: float, noise_k: float) -> GreyChoice:
    """Grow a grey box over the runs. noise_k : of a reading, at least its resolution"""
    now = frozenset[str]()
    tried = {now: fit(now, runs, step_s, noise_k)}
    while len(now) < MOST_TERMS:
        more = [terms for terms in _next(now, runs) if terms not in tried]
        for terms in more:
            tried[terms] = fit(terms, runs, step_s, noise_k, tried[now] if now < terms else None)
        best = min(more, key=lambda terms: tried[terms].rmse_k, default=now)
        if not tried[best].rmse_k < BETTER * tried[now].rmse_k:
            break
        now = best
    return GreyChoice(now, tried)


def _next(terms: Terms, runs: Sequence[GreyRun]) -> list[Terms]:
    """Return structures with one more term, or another body in the place of one."""
    fan_moved = any(run.fan is not None and np.ptp(run.fan) > 0.0 for run in runs)
    more = [
        terms | {name}
        for name in RATES
        if name not in terms
        and not (name in BODIES and terms & BODIES)
        and not (name == "dead_time" and "heater_lag" not in terms)
        and (name != "fan" or fan_moved)
    ]
    if terms & BODIES:
        more += [terms - BODIES | {body} for body in sorted(BODIES - terms)]
    return more
