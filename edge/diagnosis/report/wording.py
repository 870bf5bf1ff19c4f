"""A diagnosis in words: the sentences that the page and the terminal share."""

from collections.abc import Mapping, Sequence
from typing import Literal

from edge.diagnosis.diagnosis_document import (
    WHENS,
    DiagnosisDocument,
    EffectEntry,
    FormulaEntry,
    ParameterEntry,
    RegimeEntry,
    Role,
    WaterfallStep,
    When,
)
from edge.diagnosis.report.number_text import kelvin, number, percent, plus_minus

_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six")
ROLES: Mapping[Role, str] = {"train": "training runs", "test": "held-out test runs"}
NO_GAP = 1.05  # an error of so many noise floors or less is no gap, so no share of it can be closed
CLEAR = 2.0  # standard errors from 0 from which on a heat has a direction
NOTHING = "none"
CLEARLY_LESS = 0.95  # times an error, for a model to be called better: less is no difference
ERROR_SHARE = "squared error"  # what a finding that tells where the error lies has in it
# What findings have in them that nobody may miss: where test runs go beyond, and a second set of values.
CAUTIONS = ("in another regime", "Other values do as well")
WHITE_P = 0.05  # a run's innovations count as white from this p-value on


def headline(document: DiagnosisDocument) -> str:
    """Return the verdict as a headline."""
    effects = document["effects"]
    if document["verdict"] == "nothing_missing":
        return "Nothing is missing: no effect of the library makes the twin better"
    names = join_names([effect_text(effect) for effect in effects])
    if document["verdict"] == "named":
        count = _COUNTS[len(effects)] if len(effects) < len(_COUNTS) else str(len(effects))
        return f"{count} effect{' is' if len(effects) == 1 else 's are'} missing: {names}"
    besides = f"Besides {names}, something" if effects else "Something"
    if not (told := dependences(document)):
        return f"{besides} is missing that has no name here; these data do not tell what it depends on"
    return f"{besides} is missing that has no name here: it depends on {join_names(told)}"


def dependences(document: DiagnosisDocument) -> list[str]:
    """Return the signals that an unknown effect depends on, without the placeholder for none."""
    return [name for name in document["depends_on"] if name != NOTHING]


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


def predicting(document: DiagnosisDocument) -> list[str]:
    """How well the new twin predicts rows that no fit saw, beside simple models of the same rows."""
    known = document.get("left_out")
    if not known or not is_changed(document):
        return []
    after = rmse_k(document, "after", "test")
    told = [
        f"Over rows that no fit saw, RMSE of free runs: {kelvin(known['after_k'])} K, the twin as given "
        f"{kelvin(known['given_k'])} K; {_simple(known['simple_k'])}."
    ]
    if known["test_k"]:
        told.append(f"Over the test runs: {kelvin(after)} K; {_simple(known['test_k'])}.")
    if provisional := document.get("provisional"):
        verb = "is" if len(provisional) == 1 else "are"
        told.append(
            f"{join_names(provisional)} {verb} in the new twin because it predicts better so; that {verb} no"
            " name for what is missing."
        )
    return [*told, *beaten(document)]


def beaten(document: DiagnosisDocument) -> list[str]:
    """Return a sentence for each simpler model group that predicts better than the new twin."""
    known = document.get("left_out")
    if not known or not is_changed(document):
        return []
    told = []
    after = rmse_k(document, "after", "test")
    for where, own, simple in (
        ("rows that no fit saw", known["after_k"], known["simple_k"]),
        ("the test runs", after, known["test_k"]),
    ):
        less_k = -1.0 if own is None else CLEARLY_LESS * own
        better = [name for name, error in simple.items() if error is not None and error < less_k]
        if better:
            told.append(f"A simpler model predicts {where} better than the new twin: {join_names(better)}.")
    return told


def best_simple(document: DiagnosisDocument, key: Literal["simple_k", "test_k"]) -> str:
    """Return the baseline with the least error, `0.14 heater lag`, "" without any. key : of `left_out`"""
    left_out = document.get("left_out")
    errors = left_out[key] if left_out else {}
    known = {name: error for name, error in errors.items() if error is not None}
    best = min(known, key=lambda name: known[name], default=None)
    return "" if best is None else f"{kelvin(known[best])} {best}"


def _simple(errors: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {kelvin(error)}" for name, error in errors.items())


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


def gloss(effect: EffectEntry) -> str:
    """Return an effect in plain words without its equation: `heater_lag:
    the element warms up before it heats.`
    """
    plain = effect.get("equation", "").partition(":")[0].rstrip(". ")
    return f"{effect['name']}: {plain[:1].lower()}{plain[1:]}." if plain else f"{effect['name']}."


def where_findings(document: DiagnosisDocument) -> list[str]:
    """Return the findings that locate the error."""
    return [text for text in document.get("findings", []) if ERROR_SHARE in text]


def notices(document: DiagnosisDocument) -> list[str]:
    """Return the other findings: left-out data, and limits of these runs."""
    return [text for text in document.get("findings", []) if ERROR_SHARE not in text]


def cautions(document: DiagnosisDocument) -> list[str]:
    """Return the cautions that a reader of the figures needs, a sentence each."""
    return [f"{text}." for text in document.get("findings", []) if any(key in text for key in CAUTIONS)]


def heat_text(regime: RegimeEntry) -> str:
    """Return a regime's heat in words: `the twin gains 38 ± 3 W too much`."""
    heat, error = regime["heat_w"], regime["heat_w_se"]
    if heat is None:
        return "the heat is not known"
    if error and abs(heat) < CLEAR * error:
        return f"the residual heat is {plus_minus(heat, error)} W, no clear direction"
    return f"the twin gains {plus_minus(abs(heat), error)} W too {'much' if heat < 0.0 else 'little'}"


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


def shrink(document: DiagnosisDocument, role: Role) -> float | None:
    """Share of the gap to the noise floor that is closed; None where there is no gap, or it is not known."""
    floor = document["gap"]["noise_floor"][role]
    before, after = (rmse_k(document, when, role) for when in WHENS)
    if floor is None or before is None or after is None or not before > NO_GAP * floor:
        return None
    return min(float((before - after) / (before - floor)), 1.0)  # no twin closes more than the gap


def effect_text(effect: EffectEntry) -> str:
    """Return an effect, or a group that the data cannot tell apart:
    `fan_effectiveness (or short_circuit)`.
    """
    rivals = effect["alternatives"]
    return f"{effect['name']} (or {join_names(rivals)})" if rivals else str(effect["name"])


def parameter_text(name: str, parameter: ParameterEntry) -> str:
    """`tau_h = 183 s (95 %: 170 to 197)`."""
    unit = f" {parameter['unit']}" if parameter["unit"] else ""
    return f"{name} = {number(parameter['value'])}{unit}{interval_text(parameter)}"


def interval_text(parameter: ParameterEntry) -> str:
    """` (95 %: 170 to 197)`, "" where it is not known."""
    if parameter["low"] is None or parameter["high"] is None:
        return ""
    return f" (95 %: {number(parameter['low'])} to {number(parameter['high'])})"


def formula_text(formula: FormulaEntry) -> str:
    """Return the formula and its parameters in one line."""
    parameters = [parameter_text(name, value) for name, value in formula["parameters"].items()]
    return ", with ".join([formula["text"], *([", ".join(parameters)] if parameters else [])])


def white_runs(document: DiagnosisDocument, when: When) -> tuple[int, int]:
    """Return the number of runs with white innovations, and of runs that were tested."""
    innovations = document.get("innovations")
    found = innovations[when] if innovations else {}
    tested = [one["ljung_box_p"] for one in found.values() if one["ljung_box_p"] is not None]
    return sum(p >= WHITE_P for p in tested), len(tested)


def step_names(waterfall: Sequence[WaterfallStep]) -> list[str]:
    """Return the change of each step of the waterfall: `the twin as given`, `+ heater_lag`, `- wall_loss`."""
    names = []
    for step, last in zip(waterfall, [None, *waterfall[:-1]], strict=True):
        had = last["effects"] if last is not None else []
        added = [f"+ {name}" for name in step["effects"] if name not in had]
        removed = [f"− {name}" for name in had if name not in step["effects"]]
        names.append(", ".join(added + removed) or ("the twin as given" if last is None else "fitted anew"))
    return names


def step_error(step: WaterfallStep, role: Role) -> float | None:
    """Return the error of free runs with a step's effects [K]."""
    return step["test_rmse_k"] if role == "test" else step["train_rmse_k"]


def join_names(names: Sequence[str]) -> str:
    """Join names: `a`, `a and b`, `a, b and c`."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
