"""The types of diagnosis.json, the machine's answer; `diagnosis_schema` makes its JSON schema from them.

A reader passes over unknown keys: older versions had more, and a later one may add some.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, NotRequired, TypedDict

VerdictKind = Literal["named", "nothing_missing", "unknown"]
Role = Literal["train", "test"]
When = Literal["before", "after"]
WHENS: tuple[When, When] = ("before", "after")


@dataclass(frozen=True, slots=True)
class Meaning:
    """Describe a key for the schema.

    minimum : of a number
    """

    text: str
    minimum: float | None = None


Kelvin = Annotated[float | None, Meaning("[K]", 0)]
FloorKelvin = Annotated[float | None, Meaning("RMSE [K]", 0)]
Bound = Annotated[float | None, Meaning("of the 95 % interval, in the value's unit")]
Temperatures = list[Annotated[float | None, Meaning("air temperature [°C]")]]
Share = Annotated[float | None, Meaning("0..1", 0)]
Sentence = Annotated[str, Meaning("a sentence")]


class ValueEntry(TypedDict):
    """A value of the twin file."""

    value: Annotated[float, Meaning("in `unit`, or in the unit of the twin file")]
    low: Bound
    high: Bound


class ParameterEntry(ValueEntry):
    """A fitted parameter of an effect."""

    unit: str


class EffectEntry(TypedDict):
    """A missing effect."""

    name: Annotated[str, Meaning("of the library, see edge/twin/effects/library.py")]
    alternatives: list[Annotated[str, Meaning("an effect that these data cannot tell from it")]]
    log_odds: Annotated[float | None, Meaning("natural logarithm, against the best model without it [nat]")]
    probability: NotRequired[
        Annotated[float | None, Meaning("that it, or one of its alternatives, is missing, 0..1", 0)]
    ]
    parameters: dict[str, ParameterEntry]
    alternative_log_odds: NotRequired[
        Annotated[
            dict[str, Annotated[float | None, Meaning("natural logarithm [nat]")]],
            Meaning("of each alternative against this effect; below 0 it is the less likely one"),
        ]
    ]
    equation: NotRequired[Annotated[str, Meaning("what it is, and its equation")]]
    without: NotRequired[Annotated[str, Meaning("what the residual looks like where it is missing")]]


class RegimeEntry(TypedDict):
    """A condition of the greenhouse, and the error of the twin as given in it."""

    where: Annotated[str, Meaning("in words")]
    share_of_squared_error: Annotated[float, Meaning("0..1", 0)]
    heat_w: Annotated[
        float | None,
        Meaning(
            "constant heat in these rows that, added to the twin, explains its errors best: below 0 it gains "
            "too much [W]"
        ),
    ]
    heat_w_se: Annotated[float | None, Meaning("standard error [W]", 0)]
    share_low: NotRequired[Annotated[float | None, Meaning("of the 95 % interval, 0..1", 0)]]
    share_high: NotRequired[Annotated[float | None, Meaning("of the 95 % interval, 0..1", 0)]]
    share_of_rows: NotRequired[Share]
    rmse_k: NotRequired[Annotated[float | None, Meaning("free run before [K]", 0)]]


class RunErrors(TypedDict):
    """Errors of free runs."""

    rmse_k: Kelvin
    mae_k: Kelvin


class GapErrors(RunErrors):
    """Errors of all free runs of a role, and of each."""

    per_run: dict[str, RunErrors]


class GapSide(TypedDict):
    """Errors of one twin."""

    train: GapErrors
    test: GapErrors | None


class NoiseFloor(TypedDict):
    """Errors that a right twin would still make."""

    train: FloorKelvin
    test: FloorKelvin


class GapEntry(TypedDict):
    """The disagreement, and how far adding the effects shrinks it."""

    before: GapSide
    after: GapSide
    noise_floor: NoiseFloor


class PredictionEntry(TypedDict):
    """Predictions of a test run, a value a row."""

    before: Temperatures
    after: Temperatures


class NextExperiment(TypedDict):
    """A planned experiment, in the words of the report."""

    why: Sentence
    separates: list[Annotated[str, Meaning("an effect")]]
    duration_s: Annotated[float, Meaning("[s]", 0)]
    expected_log_odds: Annotated[float | None, Meaning("between the two that are hardest to separate [nat]")]
    profile: NotRequired[Annotated[str, Meaning("file beside this one, for `greenhouse experiment`")]]
    asks: NotRequired[list[Sentence]]
    largest_temp_air_c: NotRequired[Annotated[float | None, Meaning("that any rival predicts [°C]")]]


class WaterfallStep(TypedDict):
    """The gap with the first few effects."""

    effects: list[Annotated[str, Meaning("a name")]]
    train_rmse_k: Annotated[float | None, Meaning("free run [K]", 0)]
    test_rmse_k: Annotated[float | None, Meaning("free run [K]", 0)]


FOUND = "when it was open was found in the runs, not recorded"  # against an effect that is an event


class DoubtfulEntry(TypedDict):
    """An effect that does not stand."""

    name: Annotated[str, Meaning("an effect")]
    against: list[Sentence]


class LeftOutErrors(TypedDict):
    """Errors over rows that no fit saw."""

    given_k: Annotated[float | None, Meaning("the twin as given, what it leaves open fitted [K]", 0)]
    after_k: Annotated[float | None, Meaning("the new twin [K]", 0)]
    simple_k: Annotated[dict[str, Kelvin], Meaning("baselines by name")]
    test_k: Annotated[dict[str, Kelvin], Meaning("of the baselines over the test runs")]


class FormulaEntry(TypedDict):
    """A formula for an effect that the library does not have."""

    text: Annotated[str, Meaning("`Q = a u^2`, a heat flow into the air [W]")]
    parameters: dict[str, ParameterEntry]


class EventEntry(TypedDict):
    """A stretch of time that no model is asked to explain."""

    run: Annotated[str, Meaning("file name")]
    from_s: Annotated[float, Meaning("time in the run [s]")]
    to_s: Annotated[float, Meaning("time in the run [s]")]
    kind: Annotated[str, Meaning("such as door")]
    heat_w: Annotated[float | None, Meaning("residual heat in it [W]")]


class RequiredAnswer(TypedDict):
    """The keys that every version of diagnosis.json has."""

    verdict: VerdictKind
    effects: Annotated[list[EffectEntry], Meaning("what is missing, most important first")]
    depends_on: Annotated[
        list[Annotated[str, Meaning("a signal, or `time`")]],
        Meaning("what an unknown effect depends on, strongest first"),
    ]
    regimes: Annotated[list[RegimeEntry], Meaning("largest share of the error first")]
    gap: Annotated[GapEntry, Meaning("errors of free runs, before and after the effects are added")]
    predictions: Annotated[dict[str, PredictionEntry], Meaning("of test runs, by file name: a value a row")]
    next_experiment: Annotated[
        NextExperiment | None, Meaning("that separates rivals best; null where nothing is open")
    ]
    seconds: Annotated[float, Meaning("time that the diagnosis took [s]", 0)]


class DiagnosisDocument(RequiredAnswer, total=False):
    """diagnosis.json: the answer, its evidence and its origin."""

    waterfall: Annotated[list[WaterfallStep], Meaning("the gap after each step; first the twin as given")]
    doubtful: Annotated[list[DoubtfulEntry], Meaning("effects that the search found and that do not stand")]
    provisional: Annotated[
        list[Annotated[str, Meaning("an effect")]],
        Meaning("in the new twin because it predicts better with them; their names do not stand"),
    ]
    values: Annotated[
        dict[str, ValueEntry],
        Meaning(
            "what the runs say of values that the twin file leaves open, by place: geometry or "
            "effects.NAME.PARAMETER; 95 % intervals"
        ),
    ]
    left_out: Annotated[LeftOutErrors, Meaning("RMSE of free runs over rows that no fit saw")]
    against_adopting: Annotated[list[Sentence], Meaning("none where it is worth it")]
    formula: Annotated[FormulaEntry | None, Meaning("the best small formula of an unknown effect")]
    findings: Annotated[
        list[Sentence],
        Meaning("limits of these runs, and data that were left out"),
    ]
    events: list[EventEntry]
    data_sha256: Annotated[str, Meaning("of the runs")]
    software: Annotated[str, Meaning("name and version")]
    command: Annotated[str, Meaning("as it was typed")]
    twin_before: Annotated[str, Meaning("file beside this one")]
    twin_after: Annotated[str | None, Meaning("file beside this one; null where none is worth adopting")]
