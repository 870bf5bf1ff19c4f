"""The next experiment as diagnosis.json has it, and its profile as `greenhouse experiment` has it."""

from pathlib import Path
from typing import Any, cast

import numpy as np

from edge.diagnosis.diagnosis_document import NextExperiment
from edge.diagnosis.experiment.advice import ValueCalibration
from edge.diagnosis.experiment.experiment import PlannedExperiment
from edge.diagnosis.experiment.independent import calibration, checks
from edge.diagnosis.experiment.wording import asks, why
from edge.formats.number_table import write_table

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
