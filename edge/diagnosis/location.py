"""Disagreement of the twin before anything is added, and its remainder afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.candidates import ScoredSet
from edge.diagnosis.diagnose import Diagnosis, Side
from edge.diagnosis.diagnosis_document import EventEntry, RegimeAfterEntry, RegimeEntry, WhitenessEntry
from edge.diagnosis.locate.regimes import regimes
from edge.diagnosis.locate.residuals import Residuals, residuals_of
from edge.diagnosis.locate.sentences import findings
from edge.diagnosis.locate.stretches import stretches
from edge.diagnosis.locate.whiteness import whiteness

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """In the form of diagnosis.json.

    before, after : residuals by run name, none where a twin is too far off
    """

    regimes: list[RegimeEntry] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    events: list[EventEntry] = field(default_factory=list)
    before: Mapping[str, Residuals] = field(default_factory=dict)
    after: Mapping[str, Residuals] = field(default_factory=dict)

    white_before: Mapping[str, Floats] = field(default_factory=dict)
    white_after: Mapping[str, Floats] = field(default_factory=dict)
    step_s: float = 60.0

    def whiteness(self, when: str) -> dict[str, WhitenessEntry]:
        """Test the innovations `before` or `after`, by run."""
        runs = self.white_before if when == "before" else self.white_after
        return {name: _whiteness(values, self.step_s) for name, values in runs.items()}

    def series(self, name: str) -> dict[str, Floats]:
        """Residual heat and innovations of a run, for the report."""
        found = {}
        for when, runs, white in (
            ("before", self.before, self.white_before),
            ("after", self.after, self.white_after),
        ):
            if name in runs:
                found[f"residual_heat_{when}_w"] = runs[name].heat_w
            if name in white:
                found[f"innovations_{when}"] = white[name]
        return found


def locate(found: Diagnosis) -> Location:
    """By the residual heat of the training runs."""
    before = _residuals(found, found.before)
    after = _residuals(found, found.after)
    places = regimes(list(before.values())) if before else []
    times = stretches(list(before.values())) if before else []
    listed: list[RegimeEntry] = []
    # A share's lower end falls below 0 by its own error; a reader would take that for a mistake.
    for place in places:
        rows: RegimeEntry = {
            "where": place.where,
            "share_of_squared_error": place.share_of_squared_error,
            "heat_w": place.heat_w,
            "heat_w_se": place.heat_w_se,
            "share_low": max(place.share_low, 0.0),
            "share_high": place.share_high,
            "share_of_rows": place.share_of_rows,
            "rmse_k": place.rmse_k,
        }
        listed.append({**rows, **_afterwards(place.masks, list(before), after)})
    return Location(
        listed,
        findings(places, times),
        _events(found),
        before,
        after,
        _innovations(found, found.search.sets.base()),
        _innovations(found, found.verdict.final),
        found.before.file.sample_s,
    )


def _innovations(found: Diagnosis, item: ScoredSet) -> dict[str, Floats]:
    """In standard deviations, by run, NaN where nothing was measured, with the noise found for the set."""
    measured = np.isfinite(found.inputs.runs.temp[:, 1:])
    values = np.where(measured, item.fit.innovations, np.nan)
    return dict(zip(found.inputs.names, values, strict=True))


def _afterwards(
    masks: tuple[NDArray[np.bool_], ...], names: list[str], after: Mapping[str, Residuals]
) -> RegimeAfterEntry:
    """Return the error of the new twin over the same rows."""
    if not after:
        return {}
    pairs = [(mask, after[name]) for mask, name in zip(masks, names, strict=True)]
    free = np.concatenate([item.free_run_k[mask] for mask, item in pairs])
    heat = np.concatenate([item.heat_w[mask] for mask, item in pairs])
    free, heat = free[np.isfinite(free)], heat[np.isfinite(heat)]
    if not len(free) or not len(heat):
        return {}
    return {"rmse_after_k": float(np.sqrt(np.mean(free**2))), "heat_after_w": float(np.mean(heat))}


def _residuals(found: Diagnosis, side: Side) -> dict[str, Residuals]:
    """By run; none of a twin that is so far off that its filter has no sense."""
    try:
        every = residuals_of(side.file.twin(), found.inputs.runs, found.inputs.names, side.levels.sensor_k)
    except (DataError, np.linalg.LinAlgError):
        return {}
    return {item.name: item for item in every if np.isfinite(item.heat_w).any()}


def _events(found: Diagnosis) -> list[EventEntry]:
    return [
        {"run": door.run, "from_s": door.from_s, "to_s": door.to_s, "kind": "door", "heat_w": door.heat_w}
        for door in found.inputs.doors
    ]


def _whiteness(values: Floats, step_s: float) -> WhitenessEntry:
    found = whiteness(values, step_s)
    return {
        "ljung_box_p": found.ljung_box_p,
        "lag1_autocorrelation": found.lag1_autocorrelation,
        "strongest_period_s": found.strongest_period_s,
    }
