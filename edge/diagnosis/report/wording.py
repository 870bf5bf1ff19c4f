"""A diagnosis in words: page, terminal and the rig's page take every fact from here."""

import inspect
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

from edge.diagnosis.diagnosis_document import (
    FOUND,
    WHENS,
    DiagnosisDocument,
    EffectEntry,
    FormulaEntry,
    NextExperiment,
    ParameterEntry,
    RegimeEntry,
    Role,
    WaterfallStep,
    When,
)
from edge.diagnosis.report.number_text import (
    clock,
    kelvin,
    number,
    odds,
    percent,
    plus_minus,
    probability,
)

_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six")
ROLES: Mapping[Role, str] = {"train": "training runs", "test": "held-out test runs"}
NO_GAP = 1.05  # an error of so many noise floors or less is no gap, so no share of it can be closed
CLEAR = 2.0  # standard errors from 0 from which on a heat has a direction
NOTHING = "none"
CLEARLY_LESS = 0.95  # times an error, for a model to be called better: less is no difference
# What findings have in them that nobody may miss: where test runs go beyond, and a second set of values.
CAUTIONS = ("in another regime", "Other values do as well")
SIGNALS = {
    "heater_duty": "the heater's duty",
    "fan_on": "the fan",
    "temp_air": "the temperature of the air",
    "temp_ambient": "the temperature of the room",
    "light": "the light",
    "solar": "the sun",
    "rel_humidity": "the humidity of the air",
    "door_open": "the door",
    "time": "time: the hour, the day, or the age of the box",
}
WHERE_HEAD = "Where it disagrees, by share of the squared error:"
GAP_HEADS = ("before", "after", "noise", "closed", "best simple model")
_COLON = re.compile(r"(?<=\S): ")  # the one of `60 : 40` is not the end of an effect's name


def headline(document: DiagnosisDocument) -> str:
    """Return the verdict as a headline."""
    effects = document["effects"]
    if document["verdict"] == "nothing_missing":
        return "Nothing is missing: no effect of the library makes the twin better"
    names = join_names([effect_name(effect) for effect in effects])
    if document["verdict"] == "named":
        count = _COUNTS[len(effects)] if len(effects) < len(_COUNTS) else str(len(effects))
        return f"{count} effect{' is' if len(effects) == 1 else 's are'} missing: {names}"
    besides = f"Besides {names}, something" if effects else "Something"
    told = [f"{SIGNALS.get(name, name)} ({name})" for name in document["depends_on"] if name != NOTHING]
    if not told:
        return f"{besides} is missing that has no name here; these data do not tell what it depends on"
    return f"{besides} is missing that has no name here: it depends on {join_names(told)}"


def meaning(document: DiagnosisDocument) -> list[str]:
    """Return the meaning of a verdict without a name, a sentence or two each."""
    sentences = []
    if document["verdict"] == "nothing_missing":
        sentences.append(
            "None of the effects that were tried explains these runs better than the twin as it is, beyond"
            " what chance would bring. The twin needs no change."
        )
    if document["verdict"] == "unknown":
        sentences.append(
            "What the twin lacks is more than noise, but no name for it stands: the effect that comes nearest"
            " need not be its cause."
        )
        if formula := document.get("formula"):
            sentences.append(f"The best small formula: {formula_text(formula)}.")
    return sentences


def plain_words(effect: EffectEntry) -> tuple[str, str]:
    """Return what an effect is, without a capital, and its equation; "" for each that is not known."""
    said, _, equation = _COLON.sub("\n", effect.get("equation", "").rstrip(". "), 1).partition("\n")
    return _small(said.partition(";")[0]), equation


def effect_name(effect: EffectEntry) -> str:
    """`air leaks while the fan is off (infiltration, or longwave_radiation)`, with its alternatives."""
    said, _ = plain_words(effect)
    names = ", or ".join(filter(None, [effect["name"], " or ".join(effect["alternatives"])]))
    return f"{said} ({names})" if said else names


def known_name(name: str, further: str = "") -> str:
    """Return an effect of the library by its plain words: `radiation to the room (longwave_radiation)`."""
    inside = ", ".join(filter(None, [name, further]))
    # The page's process has no library, which needs numpy and much memory: a name alone does there.
    library = sys.modules.get("edge.twin.effects.library")
    effect = library.EFFECTS.get(name) if library else None
    if effect is None:
        return f"{name} ({further})" if further else name
    said = (inspect.getdoc(effect.add) or "").partition("\n")[0].rstrip(".")
    return f"{_small(_COLON.split(said)[0].partition(';')[0])} ({inside})"


def effect_lines(effect: EffectEntry) -> tuple[str, str, list[str]]:
    """Return an effect's name, its equation, and the evidence for it: values, probability, rivals."""
    told = [parameter_text(name, value) for name, value in effect["parameters"].items()]
    told.append(f"probability {probability(effect.get('probability'))}")
    known = effect.get("alternative_log_odds", {})
    rivals = [
        known_name(name, f"odds {odds(known[name])}" if known.get(name) is not None else "")
        for name in effect["alternatives"]
    ]
    if rivals:
        told.append(f"these data cannot tell it from {' or '.join(rivals)}")
    said, equation = plain_words(effect)
    return f"{said} ({effect['name']})" if said else effect["name"], equation, told


def doubtful(document: DiagnosisDocument) -> list[str]:
    """Return a sentence for each effect that explains the runs and is rejected; no events."""
    return [
        f"Rejected, though it fits: {known_name(item['name'])}: {'; '.join(item['against'])}"
        for item in document.get("doubtful", ())
        if FOUND not in item["against"]
    ]


def where(document: DiagnosisDocument) -> list[str]:
    """Return the regimes in which the twin as given disagrees, to stand below WHERE_HEAD."""
    found = []
    for regime in document["regimes"]:
        rows = regime.get("share_of_rows")
        of_rows = "" if rows is None else f" in {percent(rows)} of the rows"
        share = percent(regime["share_of_squared_error"])
        found.append(f"{share}{of_rows}: {regime['where']}; there {_heat(regime)}")
    return found


def doors(document: DiagnosisDocument, most: int | None = None) -> str:
    """Return when doors were open, run by run, in a sentence; "" without any. most : to list"""
    events = document.get("events", [])
    by_run: dict[str, list[str]] = {}
    for event in events[:most]:
        heat = "" if event["heat_w"] is None else f" ({number(event['heat_w'], 2)} W)"
        text = f"{clock(event['from_s'])} to {clock(event['to_s'])}{heat}"
        by_run.setdefault(event["run"], []).append(text)
    told = [f"{run} {', '.join(times)}" for run, times in by_run.items()]
    told += [f"{len(events) - most} more"] if most is not None and len(events) > most else []
    return f"A door or lid was open, found and not recorded: {'; '.join(told)}." if told else ""


def gap_sentence(document: DiagnosisDocument) -> str:
    """Errors of free runs before and after, and the noise floor."""
    role = scored_role(document)
    before, after = (rmse_k(document, when, role) for when in WHENS)
    floor = document["gap"]["noise_floor"][role]
    noise = f"; the noise floor is {kelvin(floor)} K" if floor is not None else ""
    if not is_changed(document):
        return f"On the {ROLES[role]} the twin as it is runs free with an RMSE of {kelvin(before)} K{noise}."
    closed = shrink(document, role)
    share = f": {percent(closed)} of the gap is closed" if closed is not None else ""
    return (
        f"On the {ROLES[role]} the RMSE of free runs goes from {kelvin(before)} K"
        f" to {kelvin(after)} K{noise}{share}."
    )


def gap_rows(document: DiagnosisDocument) -> list[tuple[str, ...]]:
    """Return the gap as a table: the rows' name, then a cell for each of GAP_HEADS."""
    rows: list[tuple[str, ...]] = []
    for role, name in ROLES.items():
        errors = [rmse_k(document, when, role) for when in WHENS]
        closed = shrink(document, role) if is_changed(document) else None
        simple = _best_simple(document, "test_k") if role == "test" else ""
        cells = map(kelvin, (*errors, document["gap"]["noise_floor"][role]))
        rows.append((name, *cells, percent(closed), simple))
    if known := document.get("left_out"):
        cells = map(kelvin, (known["given_k"], known["after_k"]))
        rows.append(("rows left out of fits", *cells, "", "", _best_simple(document, "simple_k")))
    return rows


def steps_text(document: DiagnosisDocument) -> str:
    """Return the waterfall of the gap in a line, "" without a step."""
    steps, role = document.get("waterfall", []), scored_role(document)
    if len(steps) < 2:
        return ""
    errors = [kelvin(step_k(step, role)) for step in steps]
    told = [f"{name} {error}" for name, error in zip(step_names(steps), errors, strict=True)]
    return f"{ROLES[role]} [K]: {', '.join(told)}"


def predicting(document: DiagnosisDocument) -> list[str]:
    """How well the new twin predicts rows that no fit saw, beside simple models of the same rows."""
    known = document.get("left_out")
    if not known or not is_changed(document):
        return []
    told = [
        f"Over rows that no fit saw, RMSE of free runs: {kelvin(known['after_k'])} K, the twin as given "
        f"{kelvin(known['given_k'])} K; {_simple(known['simple_k'])}."
    ]
    if known["test_k"]:
        after = rmse_k(document, "after", "test")
        told.append(f"Over the test runs: {kelvin(after)} K; {_simple(known['test_k'])}.")
    if provisional := document.get("provisional"):
        verb = "is" if len(provisional) == 1 else "are"
        told.append(
            f"{join_names(list(map(known_name, provisional)))} {verb} in the new twin because it predicts"
            f" better so; that {verb} no name for what is missing."
        )
    return [*told, *beaten(document)]


def beaten(document: DiagnosisDocument) -> list[str]:
    """Return a sentence for each simpler model group that predicts better than the new twin."""
    known = document.get("left_out")
    if not known or not is_changed(document):
        return []
    told = []
    after = rmse_k(document, "after", "test")
    for rows, own, simple in (
        ("rows that no fit saw", known["after_k"], known["simple_k"]),
        ("the test runs", after, known["test_k"]),
    ):
        less_k = -1.0 if own is None else CLEARLY_LESS * own
        better = [name for name, error in simple.items() if error is not None and error < less_k]
        if better:
            told.append(f"A simpler model predicts {rows} better than the new twin: {join_names(better)}.")
    return told


def cautions(document: DiagnosisDocument) -> list[str]:
    """Return the cautions that a reader of the figures needs, a sentence each."""
    return [f"{text}." for text in document.get("findings", []) if any(key in text for key in CAUTIONS)]


def against_adopting(document: DiagnosisDocument) -> list[str]:
    """Return why the new twin is not offered, a sentence each."""
    reasons = document.get("against_adopting", []) if is_changed(document) else []
    return [f"Not to be adopted: {reason}" for reason in reasons]


def experiment_lines(experiment: NextExperiment, folder: str) -> tuple[list[str], str]:
    """Return why and how the next experiment is run, and its command, "" without a profile."""
    told = [experiment["why"], *experiment.get("asks", ())]
    if (hot := experiment.get("largest_temp_air_c")) is not None:
        told.append(f"The air gets up to {number(hot)} °C.")
    if (profile := experiment.get("profile")) is None:
        return told, ""
    return told, f"greenhouse experiment {shlex.quote(str(Path(folder) / profile))} --out next_run.csv"


def is_changed(document: DiagnosisDocument) -> bool:
    """Return whether the twin after differs from the twin before."""
    return bool(document["gap"]["before"] != document["gap"]["after"])


def new_twin(document: DiagnosisDocument) -> str | None:
    """File of the twin with the effects added, beside the report; None where nothing was added."""
    name = document.get("twin_after", "twin.yaml")
    return str(name) if is_changed(document) and name else None


def scored_role(document: DiagnosisDocument) -> Role:
    """Return `test` where held-out temperatures are known, else `train`."""
    return "train" if any(rmse_k(document, when, "test") is None for when in WHENS) else "test"


def rmse_k(document: DiagnosisDocument, when: When, role: Role) -> float | None:
    """Return the error of free runs [K], None where no temperature was measured."""
    errors = document["gap"][when][role]
    return errors["rmse_k"] if errors else None


def run_errors(document: DiagnosisDocument, role: Role) -> dict[str, tuple[float | None, float | None]]:
    """Return the errors of free runs before and after, by run [K]."""
    before, after = (side["per_run"] if (side := document["gap"][when][role]) else {} for when in WHENS)
    return {
        name: (errors["rmse_k"], after[name]["rmse_k"] if name in after else None)
        for name, errors in before.items()
    }


def shrink(document: DiagnosisDocument, role: Role) -> float | None:
    """Share of the gap to the noise floor that is closed; None where there is no gap, or it is not known."""
    floor = document["gap"]["noise_floor"][role]
    before, after = (rmse_k(document, when, role) for when in WHENS)
    if floor is None or before is None or after is None or not before > NO_GAP * floor:
        return None
    return min(float((before - after) / (before - floor)), 1.0)  # no twin closes more than the gap


def parameter_text(name: str, parameter: ParameterEntry) -> str:
    """`tau_h = 183 s (95 %: 170 to 197)`."""
    unit = f" {parameter['unit']}" if parameter["unit"] else ""
    low, high = parameter["low"], parameter["high"]
    interval = "" if low is None or high is None else f" (95 %: {number(low)} to {number(high)})"
    return f"{name} = {number(parameter['value'])}{unit}{interval}"


def formula_text(formula: FormulaEntry) -> str:
    """Return the formula and its parameters in one line."""
    parameters = [parameter_text(name, value) for name, value in formula["parameters"].items()]
    return ", with ".join(filter(None, [formula["text"], ", ".join(parameters)]))


def step_names(waterfall: Sequence[WaterfallStep]) -> list[str]:
    """Return the change of each step of the waterfall: `the twin as given`, `+ heater_lag`."""
    names = ["the twin as given"]
    for last, step in pairwise(waterfall):
        names.append(", ".join(f"+ {name}" for name in step["effects"] if name not in last["effects"]))
    return names


def step_k(step: WaterfallStep, role: Role) -> float | None:
    """Return the error of free runs with a step's effects [K]."""
    return step["test_rmse_k"] if role == "test" else step["train_rmse_k"]


def join_names(names: Sequence[str]) -> str:
    """Join names: `a`, `a and b`, `a, b and c`."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def _best_simple(document: DiagnosisDocument, key: Literal["simple_k", "test_k"]) -> str:
    """Return the baseline with the least error, `0.14 heater lag`, "" without any."""
    left_out = document.get("left_out")
    errors: Iterable[tuple[str, float | None]] = left_out[key].items() if left_out else ()
    known = [(error, name) for name, error in errors if error is not None]
    return f"{kelvin(min(known)[0])} {min(known)[1]}" if known else ""


def _simple(errors: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {kelvin(error)}" for name, error in errors.items())


def _heat(regime: RegimeEntry) -> str:
    """Return a regime's heat in words: `the twin gains 38 ± 3 W too much`."""
    heat, error = regime["heat_w"], regime["heat_w_se"]
    if heat is None:
        return "the heat is not known"
    if error and abs(heat) < CLEAR * error:
        return f"the residual heat is {plus_minus(heat, error)} W, no clear direction"
    return f"the twin gains {plus_minus(abs(heat), error)} W too {'much' if heat < 0.0 else 'little'}"


def _small(text: str) -> str:
    """Without a capital at the beginning, but `UA` as it is."""
    return text if text[1:2].isupper() else f"{text[:1].lower()}{text[1:]}"
