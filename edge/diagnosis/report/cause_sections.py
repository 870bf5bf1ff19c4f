"""Sections of the page: what is missing, how sure that is, and what is left."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from edge.diagnosis.diagnosis_document import (
    CandidateEntry,
    DiagnosisDocument,
    EffectEntry,
    InnovationsEntry,
    ParameterEntry,
)
from edge.diagnosis.report.markup import TableColumn, bullets, fold, paragraph, table
from edge.diagnosis.report.number_text import DASH, duration, nats, number, odds, probability
from edge.diagnosis.report.wording import (
    dependences,
    effect_text,
    formula_text,
    interval_text,
    is_changed,
    join_names,
    notices,
    white_runs,
)

DEPENDENCES = {
    "heater_duty": "the heater's duty",
    "fan_on": "the fan",
    "temp_air": "the temperature of the air",
    "temp_ambient": "the temperature of the room",
    "light": "the light",
    "rel_humidity": "the humidity of the air",
    "time": "time: the hour, the day, or the age of the box",
}


def what(document: DiagnosisDocument) -> Iterator[str]:
    """Effects, equations and parameters; for an unknown one what it depends on."""
    if not document["effects"] and document["verdict"] == "nothing_missing":
        yield paragraph("Nothing was added: the twin stays as it is.")
    for effect in document["effects"]:
        yield from _effect(effect)
    if document["verdict"] == "unknown":
        yield from _unknown(document)
    if doubtful := document.get("doubtful"):
        yield "<h3>What explains these runs too, and does not stand</h3>"
        yield bullets(f"{item['name']}: {'; '.join(item['against'])}" for item in doubtful)


def rivals(document: DiagnosisDocument) -> Iterator[str]:
    """Effects that these data cannot tell from those that were named, and what else they cannot tell."""
    rows = list(_rival_rows(document["effects"]))
    if rows:
        columns = (
            TableColumn("rival", words=True),
            TableColumn("in the place of", words=True),
            TableColumn("log odds [nat]"),
            TableColumn("odds against the effect named", words=True),
        )
        yield from table(columns, rows)
    else:
        yield paragraph("None: no other effect explains these runs about as well.")


def search_section(document: DiagnosisDocument) -> Iterator[str]:
    """Yield the whole search, and the limits of these runs."""
    if told := notices(document):
        yield paragraph("To be kept in mind:")
        yield bullets(told)
    rounds = document.get("rounds", [])
    for place, search_round in enumerate(rounds, start=1):
        beside = join_names(search_round["beside"]) or "the twin as given"
        title = f"Round {place}: {len(search_round['candidates'])} candidates beside {beside}"
        yield from fold(title, _candidates(search_round["candidates"]))


def remainder_section(document: DiagnosisDocument) -> Iterator[str]:
    """Yield the section on the remainder: noise, or more."""
    innovations = document.get("innovations")
    if not innovations:
        yield paragraph("The innovations were not tested.", "soft")
        return
    white, tested = white_runs(document, "after")
    which = " with the new twin" if is_changed(document) else ""
    yield paragraph(
        f"Innovations, measured minus predicted from the row before, are white in {white} of {tested} runs"
        f"{which}. Where they are white, nothing is left to explain."
    )
    if is_changed(document):
        yield paragraph(
            "Each twin is judged with the noise that was found for it: a twin that lacks an effect can take"
            " it for noise, and be white too.",
            "soft",
        )
    columns = (
        TableColumn("run", words=True),
        *map(TableColumn, ("Ljung-Box p before", "after", "lag-1 autocorrelation before", "after")),
        *map(TableColumn, ("strongest period before", "after")),
    )
    yield from fold("Run by run", table(columns, list(_whiteness_rows(innovations))))


def _effect(effect: EffectEntry) -> Iterator[str]:
    yield f"<h3><code>{escape(effect_text(effect))}</code></h3>"
    if equation := effect.get("equation"):
        yield paragraph(equation)
    yield from _parameters(effect["parameters"])
    yield paragraph(f"How sure: probability {probability(effect.get('probability'))}.")
    if without := effect.get("without"):
        yield paragraph(f"Its mark in measured minus predicted: {without}.", "soft")
    if effect["alternatives"]:
        yield paragraph(
            f"These data cannot tell it from {join_names(effect['alternatives'])}: in the twin, each predicts"
            " the same, as long as the box is driven as it was here."
        )


def _parameters(parameters: Mapping[str, ParameterEntry]) -> Iterator[str]:
    columns = (
        TableColumn("parameter", words=True),
        *map(TableColumn, ("value", "95 % interval")),
        TableColumn("unit", words=True),
    )
    rows = [
        (
            name,
            number(parameter["value"]),
            interval_text(parameter).removeprefix(" (95 %: ").removesuffix(")") or DASH,
            parameter["unit"] or "1",
        )
        for name, parameter in parameters.items()
    ]
    if rows:
        yield from table(columns, rows)


def _unknown(document: DiagnosisDocument) -> Iterator[str]:
    yield "<h3>Without a name</h3>"
    if told := dependences(document):
        yield paragraph("It depends on, strongest first:")
        yield bullets(DEPENDENCES.get(name, name) for name in told)
    else:
        yield paragraph("These data do not tell what it depends on.")
    if formula := document.get("formula"):
        yield paragraph(f"The best small formula for the heat it brings [W]: {formula_text(formula)}.")
        yield from _parameters(formula["parameters"])
        yield paragraph(
            "Whoever knows what this stands for can name it: one function, one row of the table.", "soft"
        )


def _rival_rows(effects: list[EffectEntry]) -> Iterator[tuple[str, ...]]:
    for effect in effects:
        known = effect.get("alternative_log_odds", {})
        for name in effect["alternatives"]:
            said = odds(known.get(name)) if name in known else "as likely, as far as these data tell"
            yield name, effect["name"], nats(known.get(name)), said


def _candidates(candidates: list[CandidateEntry]) -> Iterator[str]:
    """Yield a table of candidates, the largest gain first."""
    ranked = sorted(
        candidates, key=lambda one: -(one["gain_nats"] if one["gain_nats"] is not None else -1e300)
    )
    columns = (
        TableColumn("candidate", words=True),
        *map(TableColumn, ("gain [nat]", "BIC", "held-out gain [nat]")),
        TableColumn("kept, or why not", words=True),
    )
    rows = [
        (
            one["name"],
            nats(one["gain_nats"]),
            nats(one["bic"]),
            nats(one["held_out_gain_nats"]),
            one["why"] or ("kept" if one["kept"] else DASH),
        )
        for one in ranked
    ]
    yield from table(columns, rows, [one["kept"] for one in ranked])


def _whiteness_rows(innovations: InnovationsEntry) -> Iterator[tuple[str, ...]]:
    for name, before in innovations["before"].items():
        pair: tuple[Mapping[str, Any], ...] = (before, innovations["after"].get(name) or {})
        yield (
            name,
            *(number(one.get("ljung_box_p"), 2) for one in pair),
            *(number(one.get("lag1_autocorrelation"), 2) for one in pair),
            *(_period(one.get("strongest_period_s")) for one in pair),
        )


def _period(seconds: float | None) -> str:
    return DASH if seconds is None else duration(seconds)
