"""The next experiment as diagnosis.json has it, in sentences, and as a profile for `greenhouse
experiment`.
"""

from pathlib import Path
from typing import Any, cast

import numpy as np

from edge.diagnosis.diagnosis_document import NextExperiment
from edge.diagnosis.experiment.advice import ValueCalibration, calibration, checks
from edge.diagnosis.experiment.experiment import PlannedExperiment
from edge.diagnosis.experiment.rivals import RIVAL_NATS
from edge.diagnosis.report.number_text import duration, nats, odds
from edge.diagnosis.report.wording import join_names
from edge.formats.number_table import write_table


def why(found: PlannedExperiment) -> str:
    """Return the experiment's purpose, its expected evidence and its limits."""
    return " ".join([*_plan_lines(found), *_same(found), *_weak(found), *_calibration_lines(found)])


def asks(found: PlannedExperiment) -> list[str]:
    """Return the further steps that a person is asked to take."""
    told = []
    if found.profile:
        told.append("Begin with the box at rest at the room's temperature, the door shut.")
    if found.swing_log_odds is not None:
        told.append(
            "If you can, let the room warm by 3 K and cool again meanwhile (a window, its heating): "
            f"what is hard to tell without would then have log odds of {nats(found.swing_log_odds)}."
        )
    return told


def _plan_lines(found: PlannedExperiment) -> list[str]:
    if not found.profile or found.expected_log_odds is None:
        return []
    kind = found.kind[:1].upper() + found.kind[1:]
    expected = f"expected log odds {nats(found.expected_log_odds)} ({odds(found.expected_log_odds)})"
    if len(found.separates) > 1 or any(len(sides) > 2 for sides in found.separates):
        expected += " between the two that are hardest to separate"
    told = (
        "separates"
        if found.expected_log_odds >= RIVAL_NATS
        else "is best to separate, though it tells little,"
    )
    sides = "; ".join(_apart([" or ".join(side) for side in sides]) for sides in found.separates)
    return [f"{kind}, {duration(found.duration_s)}, {told} {sides}: {expected}."]


def _apart(sides: list[str]) -> str:
    return " from ".join(sides) if len(sides) == 2 else f"{join_names(sides)} from one another"


def _same(found: PlannedExperiment) -> list[str]:
    return [
        f"No experiment with heater and fan can tell {join_names(group)} apart: they say the same. "
        f"What would: {_either(checks(group))}."
        for group in found.inseparable
    ]


def _weak(found: PlannedExperiment) -> list[str]:
    if not found.weak:
        return []
    pairs = join_names([f"{one} from {other}" for one, other in found.weak])
    return [f"It can hardly tell {pairs}."]


def _calibration_lines(found: PlannedExperiment) -> list[str]:
    item = found.calibration
    if item is None:
        return []
    how = calibration(item.place)
    if item.alone >= RIVAL_NATS:
        return [
            f"Calibrating {item.name} first ({how}) would settle it by itself: "
            f"expected log odds {nats(item.alone)} with that value exact."
        ]
    return [
        f"Calibrating {item.name} first ({how}) would make the experiment tell more: "
        f"expected log odds {nats(item.with_experiment)} with that value exact."
    ]


def _either(words: tuple[str, ...]) -> str:
    return ", or ".join(words)


PROFILE = "next_experiment.csv"


def experiment_document(found: PlannedExperiment) -> NextExperiment:
    """Return the experiment as diagnosis.json has it."""
    known: dict[str, Any] = {
        "why": why(found),
        "separates": found.names,
        "duration_s": found.duration_s,
        "expected_log_odds": found.expected_log_odds,
    }
    if found.profile:
        known |= {"profile": PROFILE, "kind": found.kind, "largest_temp_air_c": found.largest_temp_air_c}
    if found.between:
        known["expected_log_odds_of"] = dict(found.between)
    if found.inseparable:
        known["inseparable"] = [
            {"effects": list(group), "what_would": list(checks(group))} for group in found.inseparable
        ]
    if found.calibration is not None:
        known["calibrate_first"] = _calibration(found.calibration)
    if told := asks(found):
        known["asks"] = told
    return cast(NextExperiment, known)  # an open document: further keys are allowed


def write_profile(found: PlannedExperiment | None, folder: Path) -> None:
    """Write an experiment's profile into a folder and replace an older one. Errors: OSError"""
    path = folder / PROFILE
    if found is None or not found.profile:
        path.unlink(missing_ok=True)
        return
    columns = {
        "time_s": [row.time_s for row in found.profile],
        "heater_duty": [row.heater_duty for row in found.profile],
        "fan_on": [row.fan_on for row in found.profile],
    }
    if found.profile[0].light is not None:
        columns["light"] = [row.light or 0.0 for row in found.profile]
    aim = f", to separate {', '.join(found.names)}" if found.names else ""
    facts = {"notes": f"{found.kind}{aim}"}
    write_table(path, {name: np.array(values) for name, values in columns.items()}, facts)


def _calibration(item: ValueCalibration) -> dict[str, Any]:
    found: dict[str, Any] = {
        "value": item.name,
        "how": calibration(item.place),
        "expected_log_odds": item.alone,
    }
    if item.with_experiment is not None:
        found["expected_log_odds_with_experiment"] = item.with_experiment
    return found
