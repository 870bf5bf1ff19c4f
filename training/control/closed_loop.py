"""The whole daemon in lock-step with a virtual board: what was measured, what was so, what was driven."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import Settings
from edge.core.controller import Controller
from edge.core.controller_names import LLM
from training.lab import Lab

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ClosedLoopLog:
    """One run: columns with a row per tick, and what was counted.

    columns : as `Lab.columns`
    changes : safety rule -> commands it changed
    instead : why another controller decided -> ticks
    time_boxes : decisions that the wall clock cut short
    asked : of a language model, as `LanguageModel.counted`; "in_time" ticks that it decided when asked,
        "later" those that an older answer decided
    plans : per tick the air that the controller expected after each of the next steps [°C], or empty
    """

    columns: Mapping[str, Floats]
    changes: Counter[str]
    instead: Counter[str]
    time_boxes: int
    plans: tuple[tuple[float, ...], ...] = ()
    asked: Counter[str] = field(default_factory=Counter)

    @property
    def tokens(self) -> int:
        """Tokens of a language model, sent and received."""
        return self.asked["sent"] + self.asked["received"]


def closed_loop(settings: Settings, instead: Controller | None = None, **more: Any) -> Lab:
    """Return a lab for `settings.control.controller`, or for another one; `log_of` reads its run.

    more : as `Lab` takes it
    """
    assistance = LLM[settings.control.controller].assistance if settings.control.controller in LLM else ""
    if instead is not None:
        more |= {"more_controllers": (instead,), "experiment": instead.name}
    answer_s = settings.control.step_s - settings.control.decision_deadline_s
    return Lab(settings, recorded=assistance == "sql", answer_s=answer_s, with_truth=True, **more)


def log_of(lab: Lab, instead: Controller | None = None) -> ClosedLoopLog:
    """Return the run of `closed_loop`, with the same controller `instead`."""
    name = lab.settings.control.controller if instead is None else instead.name
    whys = [record.decision.why for record in lab.history]
    ages_s = [why["asked_s_ago"] for why in whys if "asked_s_ago" in why]
    return ClosedLoopLog(
        lab.columns(),
        Counter(
            rule for record in lab.history for rule in dict.fromkeys(change.rule for change in record.changes)
        ),
        Counter(
            str(record.decision.why.get("failure", "order"))
            for record in lab.history
            if record.decision.controller != name
        ),
        sum(bool(why.get("time_box_fired", False)) for why in whys),
        tuple(tuple(record.decision.forecast) for record in lab.history),
        Counter(lab.counted) + Counter(in_time=ages_s.count(0.0), later=len(ages_s) - ages_s.count(0.0)),
    )
