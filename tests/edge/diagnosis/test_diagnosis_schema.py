"""diagnosis.json and its schema: what is a diagnosis, and what is refused before it is written."""

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_examples import STORIES, named_story
from jsonschema import Draft202012Validator

from edge.core.errors import DataError
from edge.diagnosis import diagnosis_file
from edge.diagnosis.diagnosis_document import RequiredAnswer
from edge.diagnosis.diagnosis_file import check_diagnosis, write_json

ALWAYS = list(RequiredAnswer.__annotations__)
VALIDATOR = Draft202012Validator(diagnosis_file.schema())
UNDERSTOOD = {  # keywords of JSON Schema that check_diagnosis heeds, or that say nothing
    "type", "enum", "properties", "required", "additionalProperties", "items", "minimum", "minLength",
    "$schema", "title", "description",
}  # fmt: skip


@pytest.fixture
def document() -> dict[str, Any]:
    return copy.deepcopy(dict(named_story().document))


def set_at(document: dict[str, Any], place: tuple[Any, ...], value: Any) -> None:
    for key in place[:-1]:
        document = document[key]
    document[place[-1]] = value


def delete_at(document: dict[str, Any], place: tuple[Any, ...]) -> None:
    for key in place[:-1]:
        document = document[key]
    del document[place[-1]]


def rules(rule: Any) -> Iterator[dict[str, Any]]:
    """Every schema within a schema."""
    if not isinstance(rule, dict):
        return
    yield rule
    for below in (*rule.get("properties", {}).values(), rule.get("items"), rule.get("additionalProperties")):
        yield from rules(below)


def test_the_schema_file_is_the_one_the_code_writes() -> None:
    kept = Path(diagnosis_file.__file__).with_name("diagnosis.schema.json").read_text(encoding="utf-8")
    assert json.loads(kept) == diagnosis_file.schema()


def test_the_schema_is_one() -> None:
    Draft202012Validator.check_schema(diagnosis_file.schema())


def test_the_check_understands_every_keyword_of_the_schema() -> None:
    assert {key for rule in rules(diagnosis_file.schema()) for key in rule} <= UNDERSTOOD


@pytest.mark.parametrize("name", STORIES)
def test_every_example_is_a_diagnosis_by_the_schema_and_by_the_check(name: str) -> None:
    document = STORIES[name]().document
    check_diagnosis(document)
    VALIDATOR.validate(json.loads(json.dumps(document)))


def test_what_is_written_is_read_back_the_same(tmp_path: Path, document: dict[str, Any]) -> None:
    write_json(tmp_path / "diagnosis.json", document)
    text = (tmp_path / "diagnosis.json").read_text(encoding="utf-8")
    assert json.loads(text) == json.loads(json.dumps(document))
    assert len(text.splitlines()) == len(document) + 2  # a line a key, between two braces


@pytest.mark.parametrize("key", ALWAYS)
def test_a_key_of_the_contract_may_not_be_missing(document: dict[str, Any], key: str) -> None:
    del document[key]
    with pytest.raises(DataError, match=f"diagnosis: {key}: missing"):
        check_diagnosis(document)
    assert not VALIDATOR.is_valid(document)


def test_the_contract_is_enough(document: dict[str, Any]) -> None:
    check_diagnosis({key: document[key] for key in ALWAYS})


def test_a_report_of_an_older_or_a_later_version_is_a_diagnosis_too(document: dict[str, Any]) -> None:
    document |= {"innovations": {"before": {}, "after": {}}, "more": "of a later version"}
    document["regimes"][0] |= {"rmse_after_k": 0.1, "heat_after_w": -0.2, "heat_after_w_se": 0.1}
    document["effects"][0]["at_bound"] = []
    document["predictions"]["test_01.csv"]["one_step_after"] = None
    check_diagnosis(document)
    VALIDATOR.validate(document)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float64("nan")])
@pytest.mark.parametrize(
    ("place", "name"),
    [
        (("seconds",), "seconds"),
        (("gap", "after", "train", "rmse_k"), "gap.after.train.rmse_k"),
        (("effects", 0, "parameters", "tau_h", "low"), "effects[0].parameters.tau_h.low"),
        (("predictions", "test_01.csv", "before", 3), "predictions.test_01.csv.before[3]"),
        (("next_experiment", "largest_temp_air_c"), "next_experiment.largest_temp_air_c"),
    ],
)
def test_what_is_not_finite_is_refused_and_nothing_is_written(
    tmp_path: Path, document: dict[str, Any], place: tuple[Any, ...], name: str, value: float
) -> None:
    set_at(document, place, value)
    with pytest.raises(DataError) as refused:
        write_json(tmp_path / "diagnosis.json", document)
    assert str(refused.value) == f"diagnosis: {name}: {value} is not a finite number"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("verdict",), "perhaps"),
        (("effects", 0, "name"), ""),
        (("effects", 0, "alternatives"), None),
        (("effects", 0, "log_odds"), "812"),
        (("effects", 0, "log_odds"), True),
        (("effects", 0, "parameters", "tau_h", "value"), None),
        (("depends_on",), "heater_duty"),
        (("regimes", 1, "share_of_squared_error"), -0.01),
        (("events", 0, "kind"), 1),
        (("gap", "noise_floor"), 0.1),
        (("waterfall", 0, "train_rmse_k"), -1.0),
        (("formula",), "Q = a u^2"),
        (("seconds",), [1.0]),
    ],
)
def test_the_check_and_the_schema_refuse_alike(
    document: dict[str, Any], place: tuple[Any, ...], value: Any
) -> None:
    set_at(document, place, value)
    with pytest.raises(DataError):
        check_diagnosis(document)
    assert not VALIDATOR.is_valid(document)


@pytest.mark.parametrize(
    "place",
    [
        ("effects", 1, "alternatives"),
        ("effects", 0, "parameters", "tau_h", "high"),
        ("regimes", 0, "heat_w_se"),
        ("gap", "before", "test"),
        ("predictions", "test_01.csv", "after"),
        ("events", 0, "kind"),
    ],
)
def test_what_a_part_needs_may_not_be_missing(document: dict[str, Any], place: tuple[Any, ...]) -> None:
    delete_at(document, place)
    with pytest.raises(DataError, match="missing"):
        check_diagnosis(document)
    assert not VALIDATOR.is_valid(document)


@pytest.mark.parametrize(
    "value", [np.int64(3), np.float32(0.5), np.zeros(2), {1, 2}, Path("x"), {"deep": object()}]
)
def test_what_json_does_not_know_is_refused_with_its_place(document: dict[str, Any], value: Any) -> None:
    document["next_experiment"]["largest_temp_air_c"] = value
    with pytest.raises(DataError, match=r"next_experiment\.largest_temp_air_c"):
        check_diagnosis(document)


def test_the_verdict_agrees_with_the_effects(document: dict[str, Any]) -> None:
    with pytest.raises(DataError, match="the verdict is `nothing_missing`, but an effect is named"):
        check_diagnosis({**document, "verdict": "nothing_missing"})
    with pytest.raises(DataError, match="the verdict is `named`, but no effect is"):
        check_diagnosis({**document, "effects": []})


def test_predictions_of_a_run_have_one_length(document: dict[str, Any]) -> None:
    document["predictions"]["test_01.csv"]["after"].pop()
    with pytest.raises(DataError, match=r"predictions.test_01.csv: before and after are not of one length"):
        check_diagnosis(document)
