"""diagnosis.json and the series of its report, from a diagnosis."""

import inspect
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.core.version import __version__
from edge.diagnosis.adopted_twin import plain_numbers
from edge.diagnosis.depends import Dependence
from edge.diagnosis.diagnose import Diagnosis, Side
from edge.diagnosis.diagnosis_document import (
    DiagnosisDocument,
    EffectEntry,
    FormulaEntry,
    LeftOutErrors,
    ParameterEntry,
    ValueEntry,
    WaterfallStep,
)
from edge.diagnosis.experiment.document import experiment_document
from edge.diagnosis.experiment.plan import PlannedExperiment
from edge.diagnosis.gap import RunForecast, columns_of, errors, known_errors
from edge.diagnosis.judge import MissingEffect, interval
from edge.diagnosis.report.story import Trace
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.twin_choice import OPEN
from edge.diagnosis.where import Location
from edge.twin.effects.library import EFFECTS
from edge.twin.value import SDS_95, Value

INPUTS = ("heater_duty", "fan_on", "temp_ambient", "light", "solar", "rel_humidity", "door_open")
_BRACKETS = re.compile(r"\([^()]*\)|\|[^|]*\|")
Floats = NDArray[np.float64]


def answer(
    found: Diagnosis, located: Location, command: str, experiment: PlannedExperiment | None
) -> DiagnosisDocument:
    """Return the document, NaN and infinity as null."""
    document: DiagnosisDocument = {
        "verdict": found.verdict.kind,
        "effects": [_effect(item) for item in found.verdict.effects],
        "depends_on": list(found.verdict.depends_on),
        "regimes": located.regimes,
        "gap": {
            "before": {"train": known_errors(found.before.train), "test": errors(found.before.test)},
            "after": {"train": known_errors(found.after.train), "test": errors(found.after.test)},
            "noise_floor": {
                "train": found.inputs.noise_k,
                "test": found.inputs.noise_k if errors(found.before.test) else None,
            },
        },
        "predictions": {
            named.name: {
                "before": named.at_rows(before.predicted).tolist(),
                "after": named.at_rows(after.predicted).tolist(),
            }
            for named, before, after in zip(found.data.test, found.before.test, found.after.test, strict=True)
        },
        "next_experiment": None if experiment is None else experiment_document(experiment),
        "seconds": round(found.seconds, 2),
        "waterfall": [_step(names, side) for names, side in found.steps],
        "formula": _formula(found.verdict.depends) if found.verdict.kind == "unknown" else None,
        "findings": [
            *found.data.notes,
            *found.inputs.notes,
            *_contradictions(found),
            *found.data.cannot_tell,
        ],
        "events": located.events,
        "data_sha256": found.data.data_sha256,
        "software": f"greenhouse-twin {__version__}",
        "command": command,
        "twin_before": "twin_before.yaml",
        "twin_after": "twin.yaml" if found.is_offered else None,
        "doubtful": [{"name": item.name, "against": list(item.against)} for item in found.verdict.doubtful],
        "provisional": [name for name in found.verdict.provisional if name in EFFECTS],
        "values": _values(found),
        "left_out": _left_out(found),
        "against_adopting": list(found.against_adopting),
    }
    # JSON has no NaN: what is not known is null, for every reader.
    plain: DiagnosisDocument = plain_numbers(document)
    return plain


def _effect(item: MissingEffect) -> EffectEntry:
    effect = EFFECTS[item.name]
    return {
        "name": item.name,
        "alternatives": list(item.alternatives),
        "log_odds": item.log_odds,
        "probability": item.probability,
        "parameters": {
            parameter.name: _parameter(item.parameters[parameter.name], parameter.unit)
            for parameter in effect.parameters
        },
        "alternative_log_odds": dict(item.alternatives),
        "equation": (inspect.getdoc(effect.add) or "").splitlines()[0],
        "without": effect.without,
    }


def _values(found: Diagnosis) -> dict[str, ValueEntry]:
    """Return the fitted values of what the twin file leaves open or uncertain."""
    fit, given = found.verdict.handed.fit, found.inputs.given.values()
    own: dict[str, ValueEntry] = {}
    for item, x, variance in zip(fit.free, fit.x, np.diag(fit.covariance), strict=True):
        if item.place in given:
            value = interval(item, float(x), float(variance))
            own[".".join(item.place)] = {"value": value.value, "low": value.low, "high": value.high}
    return own


def _contradictions(found: Diagnosis) -> list[str]:
    """Return sentences about stated values that the runs contradict, and about what only ratios tell."""
    given, fit, told = found.inputs.given.values(), found.verdict.handed.fit, list[str]()
    if given["geometry", "heater_max_w"].fit:
        told.append(
            "the heater's power is open, so that only ratios to it can be known: all powers, losses and "
            "capacities are in proportion to the one that was assumed"
        )
    if OPEN not in found.verdict.handed.added:
        return told
    for item, x in zip(fit.free, fit.x, strict=True):
        if item.place not in given or (rel_sd := given[item.place].rel_sd) is None:
            continue
        stated = given[item.place].value
        if abs(item.value(x) / stated - 1.0) > SDS_95 * rel_sd:
            told.append(
                f"{'.'.join(item.place)} is {item.value(x):.3g}, where the twin file says "
                f"{stated:.3g} and to {100.0 * rel_sd:.0f} %"
            )
    return told


def _left_out(found: Diagnosis) -> LeftOutErrors:
    """Return the errors of free runs over rows that no fit saw."""
    simple = found.baselines
    return {
        "given_k": found.choice.tried[frozenset()].left_out_k,
        "after_k": found.verdict.handed.left_out_k,
        "simple_k": dict(simple.left_out_k),
        "test_k": dict(simple.test_k),
    }


def _parameter(value: Value, unit: str) -> ParameterEntry:
    return {"value": value.value, "low": value.low, "high": value.high, "unit": unit}


def _formula(terms: Sequence[Dependence]) -> FormulaEntry | None:
    if not terms:
        return None
    term = terms[0]
    parameters: dict[str, ParameterEntry] = {
        "a": {"value": term.value, "low": None, "high": None, "unit": term.unit}
    }
    # A sum is a factor only inside brackets.
    factor = f"({term.text})" if re.search(r" [+-] ", _BRACKETS.sub("", term.text)) else term.text
    return {"text": f"Q = a {factor}", "parameters": parameters}


def _step(names: tuple[str, ...], side: Side) -> WaterfallStep:
    train, test = errors(side.train), errors(side.test)
    return {
        "effects": list(names),
        "train_rmse_k": None if train is None else train["rmse_k"],
        "test_rmse_k": None if test is None else test["rmse_k"],
    }


def traces(found: Diagnosis, located: Location) -> tuple[Trace, ...]:
    """Return the series of each run for the report's pictures."""
    pairs = [
        *zip(found.inputs.train, found.before.train, found.after.train, strict=True),
        *zip(found.data.test, found.before.test, found.after.test, strict=True),
    ]
    return tuple(_trace(found, located, named, before, after) for named, before, after in pairs)


def _trace(
    found: Diagnosis, located: Location, named: NamedRun, before: RunForecast, after: RunForecast
) -> Trace:
    columns = columns_of(named.run, after.room_c)
    time_s = named.run.columns["time_s"]
    innovations = located.innovations.get(named.name)
    return Trace(
        named.name,
        "train" if named.name in found.inputs.names else "test",
        time_s,
        columns["temp_air"],
        before.predicted,
        after.predicted,
        None if innovations is None else _at_rows(innovations, columns["temp_air"]),
        {key: columns[key] for key in INPUTS if key in columns},
    )


def _at_rows(innovations: Floats, temp_air: Floats) -> Floats:
    """Return a value a row, from one a step after the first reading: an error stands at its reading's row."""
    filled, first = np.full(len(temp_air), np.nan), int(np.isfinite(temp_air).argmax()) + 1
    count = min(len(innovations), len(temp_air) - first)
    filled[first : first + count] = innovations[:count]
    return filled
