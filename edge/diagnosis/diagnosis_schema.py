"""The JSON schema of diagnosis.json, the machine's answer: run this module to print it.

The first eight keys are always there. A later version may add keys: a reader passes over what it does not
know.
"""

import json
from typing import Any

Schema = dict[str, Any]

TITLE = (
    "Diagnosis of a twin: where it disagrees with the measurements, what is missing, what adding it brings"
)
ALWAYS = ("verdict", "effects", "depends_on", "regimes", "gap", "predictions", "next_experiment", "seconds")
VERDICTS = ("named", "nothing_missing", "unknown")


def schema() -> Schema:
    """JSON Schema, draft 2020-12, as plain values."""
    properties = _answer() | _evidence() | _origin()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": TITLE,
        **_object(properties, optional=[key for key in properties if key not in ALWAYS]),
    }


def document() -> str:
    """The schema as the file in this folder has it."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def _answer() -> dict[str, Schema]:
    """What is always there."""
    gap = {
        "before": _object({"train": _errors(), "test": _or_null(_errors())}),
        "after": _object({"train": _errors(), "test": _or_null(_errors())}),
        "noise_floor": _object(
            {"train": _or_null(_number("RMSE [K]", 0)), "test": _or_null(_number("RMSE [K]", 0))}
        ),
    }
    prediction = {key: _list(_or_null(_number("air temperature [°C]"))) for key in ("before", "after")}
    prediction["one_step_after"] = _list(_or_null(_number("from the measurements up to the row before [°C]")))
    return {
        "verdict": {"enum": list(VERDICTS)},
        "effects": {**_list(_effect()), "description": "what is missing, most important first"},
        "depends_on": {
            **_list(_text("a signal, or `time`")),
            "description": "what an unknown effect depends on, strongest first",
        },
        "regimes": {**_list(_regime()), "description": "largest share of the error first"},
        "gap": {**_object(gap), "description": "errors of free runs, before and after the effects are added"},
        "predictions": {
            **_map(_object(prediction, optional=["one_step_after"])),
            "description": "of test runs, by file name: a value a row",
        },
        "next_experiment": {
            "type": ["object", "null"],
            "properties": _next_experiment(),
            "description": "that separates rivals best; null where nothing is open",
        },
        "seconds": _number("time that the diagnosis took [s]", 0),
    }


def _evidence() -> dict[str, Schema]:
    """What the answer rests on."""
    step = {
        "effects": _list(_text("a name")),
        "train_rmse_k": _or_null(_number("free run [K]", 0)),
        "test_rmse_k": _or_null(_number("free run [K]", 0)),
    }
    search_round = {"beside": _list(_text("an effect in the model")), "candidates": _list(_candidate())}
    formula = {
        "text": _text("`Q = a u^2`, a heat flow into the air [W]"),
        "terms": _list(_text("a term")),
        "parameters": _map(_parameter()),
    }
    event = {
        "run": _text("file name"),
        "from_s": _number("time in the run [s]"),
        "to_s": _number("time in the run [s]"),
        "kind": _text("such as door"),
        "heat_w": _or_null(_number("residual heat in it [W]")),
    }
    return {
        "waterfall": {
            **_list(_object(step)),
            "description": "the gap after each step; first the twin as given",
        },
        "rounds": {**_list(_object(search_round)), "description": "the search, round by round"},
        "doubtful": {
            **_list(_object({"name": _text("an effect"), "against": _list(_text("a sentence"))})),
            "description": "effects that the search found and that do not stand",
        },
        "provisional": {
            **_list(_text("an effect")),
            "description": "in the new twin because it predicts better with them; their names do not stand",
        },
        "values": {
            **_map(
                _object({"value": _number("in the unit of the twin file"), "low": _bound(), "high": _bound()})
            ),
            "description": "what the runs say of values that the twin file leaves open, by place: geometry "
            "or effects.NAME.PARAMETER; 95 % intervals",
        },
        "left_out": {
            **_object(
                {
                    "given_k": _or_null(_number("the twin as given, what it leaves open fitted [K]", 0)),
                    "after_k": _or_null(_number("the new twin [K]", 0)),
                    "simple_k": {
                        **_map(_or_null(_number("[K]", 0))),
                        "description": "baselines by name",
                    },
                    "test_k": {
                        **_map(_or_null(_number("[K]", 0))),
                        "description": "of the baselines over the test runs",
                    },
                }
            ),
            "description": "RMSE of free runs over rows that no fit saw",
        },
        "against_adopting": {**_list(_text("a sentence")), "description": "none where it is worth it"},
        "formula": {
            **_or_null(_object(formula)),
            "description": "the best small formula of an unknown effect",
        },
        "findings": {**_list(_text("a sentence")), "description": "of where it disagrees, strongest first"},
        "events": _list(_object(event)),
        "innovations": _object({"before": _map(_whiteness()), "after": _map(_whiteness())}),
    }


def _origin() -> dict[str, Schema]:
    """What it was made from, and with what."""
    return {
        "data_sha256": _text("of the runs"),
        "software": _text("name and version"),
        "command": _text("as it was typed"),
        "twin_before": _text("file beside this one"),
        "twin_after": _or_null(_text("file beside this one; null where none is worth adopting")),
    }


def _effect() -> Schema:
    known = {
        "name": _text("of the library, see edge/twin/effects/library.py"),
        "alternatives": _list(_text("an effect that these data cannot tell from it")),
        "log_odds": _or_null(_number("natural logarithm, against the best model without it [nat]")),
        "probability": _or_null(_number("that it, or one of its alternatives, is missing, 0..1", 0)),
        "left_out": {
            **_map(_or_null(_number("nats, or an RMSE of free runs [K]"))),
            "description": "what rows that no fit saw say of it: nats gained, all and errors that go "
            "together counted once; errors with it, without it, and of a reading",
        },
        "parameters": _map(_parameter()),
        "alternative_log_odds": {
            **_map(_or_null(_number("natural logarithm [nat]"))),
            "description": "of each alternative against this effect; below 0 it is the less likely one",
        },
        "equation": _text("what it is, and its equation"),
        "without": _text("what the residual looks like where it is missing"),
        "at_bound": _list(_text("a parameter that ended at its physical bound")),
    }
    return _object(
        known, optional=["probability", "left_out", "alternative_log_odds", "equation", "without", "at_bound"]
    )


def _parameter() -> Schema:
    ends = {"low": _bound(), "high": _bound()}
    return _object({"value": _number("in `unit`"), **ends, "unit": {"type": "string"}})


def _bound() -> Schema:
    return _or_null(_number("of the 95 % interval, in the value's unit"))


def _regime() -> Schema:
    known = {
        "where": _text("in words"),
        "share_of_squared_error": _number("0..1", 0),
        "heat_w": _or_null(
            _number("mean residual heat, measured minus the twin's: below 0 it gains too much [W]")
        ),
        "heat_w_se": _or_null(_number("standard error [W]", 0)),
        "share_low": _or_null(_number("of the 95 % interval, 0..1", 0)),
        "share_high": _or_null(_number("of the 95 % interval, 0..1", 0)),
        "share_of_rows": _or_null(_number("0..1", 0)),
        "rmse_k": _or_null(_number("free run before [K]", 0)),
        "rmse_after_k": _or_null(_number("free run after [K]", 0)),
        "heat_after_w": _or_null(_number("with the effects added [W]")),
        "heat_after_w_se": _or_null(_number("standard error [W]", 0)),
    }
    return _object(known, optional=list(known)[4:])


def _errors() -> Schema:
    error = {"rmse_k": _or_null(_number("[K]", 0)), "mae_k": _or_null(_number("[K]", 0))}
    return _object({**error, "per_run": _map(_object(error))})


def _candidate() -> Schema:
    known = {
        "name": _text("an effect, a pair `one + other`, or a formula"),
        "gain_nats": _or_null(_number("log likelihood over the model of the round [nat]")),
        "bic": _or_null(_number("Bayesian information criterion, the smaller the better")),
        "held_out_gain_nats": _or_null(_number("on runs left out of the fit [nat]")),
        "kept": {"type": "boolean"},
        "why": {"type": "string", "description": "kept, or why not"},
    }
    return _object(known)


def _whiteness() -> Schema:
    known = {
        "ljung_box_p": _or_null(_number("p-value of the Ljung-Box test: small where not white", 0)),
        "lag1_autocorrelation": _or_null(_number("-1..1")),
        "strongest_period_s": _or_null(_number("of the periodogram [s]", 0)),
    }
    return _object(known)


def _next_experiment() -> dict[str, Schema]:
    """What the report knows how to word; a design may say more."""
    return {
        "profile": _text("file beside this one, for `greenhouse experiment`"),
        "why": _text("a sentence"),
        "separates": _list(_text("an effect")),
        "duration_s": _number("[s]", 0),
        "expected_log_odds": _or_null(_number("between the two that are hardest to separate [nat]")),
    }


def _object(properties: dict[str, Schema], optional: list[str] | None = None) -> Schema:
    required = [key for key in properties if key not in (optional or ())]
    return {
        "type": "object",
        "additionalProperties": False,
        "required": required,
        "properties": properties,
    }


def _map(values: Schema) -> Schema:
    return {"type": "object", "additionalProperties": values}


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _or_null(kind: Schema) -> Schema:
    return {**kind, "type": [kind["type"], "null"]}


def _number(description: str, minimum: float | None = None) -> Schema:
    bound = {} if minimum is None else {"minimum": minimum}
    return {"type": "number", "description": description, **bound}


def _text(description: str) -> Schema:
    return {"type": "string", "minLength": 1, "description": description}


if __name__ == "__main__":
    print(document(), end="")
