"""diagnosis.json and the series of its report, from a diagnosis."""

import inspect
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.version import __version__
from edge.diagnosis.diagnose import Diagnosis, Side
from edge.diagnosis.diagnosis_document import (
    CandidateEntry,
    DiagnosisDocument,
    EffectEntry,
    FormulaEntry,
    LeftOutErrors,
    NextExperiment,
    ParameterEntry,
    PredictionEntry,
    RoundEntry,
    ValueEntry,
    WaterfallStep,
)
from edge.diagnosis.gap import columns_of, errors, known_errors
from edge.diagnosis.location import Location
from edge.diagnosis.report.story import Trace
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.search import Round
from edge.diagnosis.verdict import Coefficient, MissingEffect, interval
from edge.twin.effects.library import EFFECTS
from edge.twin.value import Value

DIGITS = 6


def answer(
    found: Diagnosis, located: Location, command: str, experiment: NextExperiment | None
) -> DiagnosisDocument:
    """Return the document, NaN and infinity as null."""
    document: DiagnosisDocument = {
        "verdict": found.verdict.kind,
        "effects": [_effect(item, found) for item in found.verdict.effects],
        "depends_on": list(found.verdict.depends_on),
        "regimes": located.regimes,
        "gap": {
            "before": {"train": known_errors(found.before.train), "test": errors(found.before.test)},
            "after": {"train": known_errors(found.after.train), "test": errors(found.after.test)},
            "noise_floor": {"train": found.floor_k[0], "test": found.floor_k[1]},
        },
        "predictions": {named.name: _prediction(found, i) for i, named in enumerate(found.data.test)},
        "next_experiment": experiment,
        "seconds": round(found.seconds, 2),
        "waterfall": [_step(names, side) for names, side in found.steps],
        "rounds": [_round(item, found) for item in found.search.rounds],
        "formula": _formula(found.verdict.formula),
        "findings": [
            *located.findings,
            *found.data.notes,
            *found.inputs.notes,
            *found.judgement.notes,
            *found.data.cannot_tell,
        ],
        "events": located.events,
        "innovations": {"before": located.whiteness("before"), "after": located.whiteness("after")},
        "data_sha256": found.data.data_sha256,
        "software": f"greenhouse-twin {__version__}",
        "command": command,
        "twin_before": "twin_before.yaml",
        "twin_after": "twin.yaml" if found.is_offered else None,
        "doubtful": [
            {"name": item.effect.name, "against": list(item.against)} for item in found.judgement.doubtful
        ],
        "provisional": list(found.judgement.provisional),
        "values": _values(found),
        "left_out": _left_out(found),
        "against_adopting": list(found.against_adopting),
    }
    # JSON has no NaN: what is not known is null, for every reader.
    plain: DiagnosisDocument = _plain(document)
    return plain


def _effect(item: MissingEffect, found: Diagnosis) -> EffectEntry:
    effect = EFFECTS[item.name]
    return {
        "name": item.name,
        "alternatives": list(item.alternatives),
        "log_odds": item.log_odds,
        "probability": found.judgement.standings[item.name].probability,
        "left_out": _told_of(item, found),
        "parameters": {
            parameter.name: _parameter(item.parameters[parameter.name], parameter.unit)
            for parameter in effect.parameters
        },
        "alternative_log_odds": dict(item.alternatives),
        "equation": (inspect.getdoc(effect.add) or "").splitlines()[0],
        "without": effect.without,
        "at_bound": list(item.at_bound),
    }


def _values(found: Diagnosis) -> dict[str, ValueEntry]:
    """Return the fitted values of what the twin file leaves open or uncertain."""
    fitted, given = found.judgement.handover.fit, found.inputs.file.values()
    own: dict[str, ValueEntry] = {}
    for i, item in enumerate(fitted.free):
        if item.place in given:
            value = interval(item, float(fitted.coordinates[i]), float(fitted.covariance[i, i]))
            own[".".join(item.place)] = {"value": value.value, "low": value.low, "high": value.high}
    return own


def _told_of(item: MissingEffect, found: Diagnosis) -> dict[str, float | None]:
    """Return the evidence that left-out rows give for a name."""
    standing = found.judgement.standings[item.name]
    return {
        "gain_nats": standing.gain_nats,
        "tempered_nats": standing.tempered_nats,
        "with_k": standing.with_k,
        "without_k": standing.without_k,
        "noise_k": standing.noise_k,
    }


def _left_out(found: Diagnosis) -> LeftOutErrors:
    """Return the errors of free runs over rows that no fit saw."""
    compared = found.judgement.comparison
    return {
        "given_k": compared.trials[frozenset()].rmse_k,
        "after_k": found.judgement.handover.rmse_k,
        "simple_k": dict(compared.simple_k),
        "test_k": {name: error for name, error in found.test_k.items() if name in compared.simple_k},
    }


def _parameter(value: Value, unit: str) -> ParameterEntry:
    return {"value": value.value, "low": value.low, "high": value.high, "unit": unit}


def _formula(terms: Sequence[Coefficient]) -> FormulaEntry | None:
    if not terms:
        return None
    letters = "abcdefgh"
    reading = "reading: "
    text = " + ".join(
        f"{letter} {term.text.removeprefix(reading)}" for letter, term in zip(letters, terms, strict=False)
    )
    of_reading = terms[0].text.startswith(reading)
    return {
        "text": ("error of the reading = " if of_reading else "Q = ") + text,
        "terms": [term.text for term in terms],
        "parameters": {
            letter: {"value": term.value, "low": term.low, "high": term.high, "unit": term.unit}
            for letter, term in zip(letters, terms, strict=False)
        },
    }


def _step(names: tuple[str, ...], side: Side) -> WaterfallStep:
    train, test = errors(side.train), errors(side.test)
    return {
        "effects": list(names),
        "train_rmse_k": None if train is None else train["rmse_k"],
        "test_rmse_k": None if test is None else test["rmse_k"],
    }


def _round(item: Round, found: Diagnosis) -> RoundEntry:
    final = {effect.name for effect in found.verdict.effects}
    gains = {name: item.gain_nats for name, item in found.judgement.standings.items()}
    candidates: list[CandidateEntry] = []
    for tried in item.candidates:
        kept = tried.name in final
        candidates.append(
            {
                "name": tried.name.removeprefix("~"),
                "gain_nats": tried.gain_nats,
                "bic": -2.0 * tried.score_gain,
                "held_out_gain_nats": gains.get(tried.name),
                "kept": kept,
                "why": "in the final set" if kept else _why_not(tried.score_gain, tried.name, found),
            }
        )
    return {"beside": sorted(name.removeprefix("~") for name in item.beside), "candidates": candidates}


def _why_not(score_gain: float, name: str, found: Diagnosis) -> str:
    for effect in found.verdict.effects:
        if name in effect.alternatives:
            return f"can't be told from {effect.name}"
    for doubtful in found.judgement.doubtful:
        if name == doubtful.effect.name:
            return "; ".join(doubtful.against)
    if score_gain <= 0.0:
        return "explains less than chance does with so many candidates"
    return "needless beside what was kept"


def _prediction(found: Diagnosis, i: int) -> PredictionEntry:
    named = found.data.test[i]
    return {
        "before": named.at_rows(found.before.test[i].predicted).tolist(),
        "after": named.at_rows(found.after.test[i].predicted).tolist(),
        "one_step_after": named.at_rows(found.one_step[i]).tolist(),
    }


def traces(found: Diagnosis, located: Location) -> tuple[Trace, ...]:
    """Return the series of each run for the report's pictures."""
    pairs = [
        *zip(found.data.train, found.before.train, found.after.train, strict=True),
        *zip(found.data.test, found.before.test, found.after.test, strict=True),
    ]
    return tuple(
        _trace(found, located, named, before.predicted, after.predicted) for named, before, after in pairs
    )


def _trace(found: Diagnosis, located: Location, named: NamedRun, before: Any, after: Any) -> Trace:
    columns = columns_of(named.run, found.inputs.room_of(named))
    time_s = named.run.columns["time_s"]
    role = "train" if named.name in found.inputs.names else "test"
    series = {key: _fitting(values, len(time_s)) for key, values in located.series(named.name).items()}
    return Trace(
        named.name,
        role,
        time_s,
        columns["temp_air"],
        before,
        after,
        columns["heater_duty"],
        columns["fan_on"],
        columns["temp_ambient"],
        **series,
    )


def _fitting(values: Any, rows: int) -> Any:
    """One value a row of the run, from one a step: what a row's measurement tells stands at that row."""
    filled = np.full(rows, np.nan)
    count = min(len(values), rows - 1)
    filled[1 : 1 + count] = values[:count]
    return filled


def _plain(value: Any) -> Any:
    """As JSON knows it: no NumPy, no number that is none."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{DIGITS}g}") if math.isfinite(value) else None
    if value is not None and not isinstance(value, str):
        raise DataError(f"diagnosis: {type(value).__name__} is no value of a document")
    return value
