"""edge/formats: reader, cross_check, parsing. Every class allows what it says, and errors look alike."""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import time
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.input_file import SMALL, YAML
from edge.formats.parsing import DEPTH_MAX
from edge.formats.reader import DocumentError, parse_json, parse_yaml, read, read_json, read_number, read_yaml


class Paint(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Wheel:
    size_m: Annotated[float, Rule(above=0.0, high=2.0)]
    spokes: Annotated[int, Rule(low=3)] = 20


@dataclass(frozen=True)
class Bicycle(CheckedDocument):
    format: Literal[1]
    wheels: Annotated[tuple[Wheel, ...], Rule(least=1, most=3)]
    colour: Paint = Paint.RED
    owner: str = field(default="", metadata={"rule": Rule(pattern="[a-z]*"), "key": "from"})
    gears: Mapping[Annotated[str, Rule(pattern="g[0-9]")], float] = field(default_factory=dict)
    span: tuple[float, float] | None = None
    lights: bool = False
    at: time = time(8)
    notes: Any = None

    def cross_check(self) -> None:
        if self.span is not None and self.span[0] > self.span[1]:
            self.refuse("span", "falls")


GOOD: dict[str, Any] = {"format": 1, "wheels": [{"size_m": 1}]}


def refusals(change: Mapping[str, Any]) -> list[str]:
    with pytest.raises(DocumentError) as refusal:
        read(Bicycle, {**GOOD, **change}, "bike.json")
    text = str(refusal.value)
    assert text.startswith("bike.json: ")
    assert "\n" not in text
    return refusal.value.problems


def test_a_good_document_becomes_its_class() -> None:
    document = {
        **GOOD,
        "colour": "blue",
        "from": "ada",
        "gears": {"g1": 2, "g2": 0.5},
        "span": [1, 2.5],
        "lights": True,
        "at": "07:30",
        "notes": {"any": [1, None]},
    }
    found = read(Bicycle, document)
    assert found == Bicycle(
        1,
        (Wheel(1.0, 20),),
        Paint.BLUE,
        "ada",
        {"g1": 2.0, "g2": 0.5},
        (1.0, 2.5),
        True,
        time(7, 30),
        {"any": [1, None]},
    )
    assert type(found.wheels[0].size_m) is float  # also where the document has a whole number


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"colou": "red"}, "unknown key 'colou'; did you mean 'colour'?"),
        ({"format": True}, "format: True is not 1"),
        ({"format": 1.0}, "format: 1.0 is not 1"),
        ({"wheels": []}, "wheels: must hold 1 to 3, not 0"),
        ({"wheels": {}}, "wheels: must be a list, not {}"),
        ({"wheels": [{}]}, "wheels[0].size_m: missing"),
        ({"wheels": [[]]}, "wheels[0]: must hold keys and values, not []"),
        ({"wheels": [None]}, "wheels[0]: must hold keys and values, not None"),
        ({"wheels": [{"size_m": 1, "spokez": 3}]}, "wheels[0]: unknown key 'spokez'; did you mean 'spokes'?"),
        ({"wheels": [{"size_m": 0}]}, "wheels[0].size_m: 0 is not above 0"),
        ({"wheels": [{"size_m": 2.5}]}, "wheels[0].size_m: 2.5 is above the largest allowed, 2"),
        ({"wheels": [{"size_m": math.nan}]}, "wheels[0].size_m: nan is not a finite number"),
        ({"wheels": [{"size_m": -math.inf}]}, "wheels[0].size_m: -inf is not a finite number"),
        ({"wheels": [{"size_m": 10**400}]}, "is not a finite number"),
        ({"wheels": [{"size_m": True}]}, "wheels[0].size_m: must be a number, not True"),
        ({"wheels": [{"size_m": "1"}]}, "wheels[0].size_m: must be a number, not '1'"),
        ({"wheels": [{"size_m": None}]}, "wheels[0].size_m: must be a number, not None"),
        ({"wheels": [{"size_m": 1, "spokes": 4.0}]}, "wheels[0].spokes: must be a whole number, not 4.0"),
        ({"wheels": [{"size_m": 1, "spokes": True}]}, "wheels[0].spokes: must be a whole number, not True"),
        ({"colour": "green"}, "colour: 'green' is none of red, blue"),
        ({"colour": ["red"]}, "colour: ['red'] is none of red, blue"),
        ({"from": "Ada"}, "from: 'Ada' does not match [a-z]*"),
        ({"owner": "ada"}, "unknown key 'owner'"),
        ({"gears": {"h1": 1}}, "gears.h1: 'h1' does not match g[0-9]"),
        ({"gears": {1: 1}}, "gears.1: must be text, not 1"),
        ({"gears": None}, "gears: must hold keys and values, not None"),
        ({"span": [1]}, "span: must be a list of 2, not [1]"),
        ({"span": [2, 1]}, "span: falls"),
        ({"span": [1, False]}, "span[1]: must be a number, not False"),
        ({"lights": 1}, "lights: must be true or false, not 1"),
        ({"at": "7:30"}, "at: must be \"HH:MM\", not '7:30'"),
        ({"at": "07:30+01:00"}, "at: must be"),
    ],
)
def test_what_a_class_does_not_allow_is_refused_with_its_place(change: dict[str, Any], says: str) -> None:
    (line,) = refusals(change)
    assert says in line


def test_a_missing_key_is_refused() -> None:
    with pytest.raises(DocumentError, match=r"^format: missing; wheels: missing$"):
        read(Bicycle, {})


def test_all_problems_are_named_at_once_but_no_flood_of_them() -> None:
    assert len(refusals({"lights": 0, "at": 0})) == 2
    with pytest.raises(DocumentError, match=r"^a\.json: (unknown key[^;]*; known [^;]*; ){4}and 46 more$"):
        read(Bicycle, {f"x{number}": 0 for number in range(50)}, "a.json")


def test_an_empty_section_is_all_defaults_where_a_key_without_a_value_is_one() -> None:
    assert read(Bicycle, {**GOOD, "gears": None}, null_is_empty=True).gears == {}
    with pytest.raises(DocumentError):
        read(Bicycle, {**GOOD, "wheels": None}, null_is_empty=True)


def test_a_number_is_held_to_bounds_that_its_reader_gives() -> None:
    assert read_number(3, "x", 0.0, 3.0) == 3.0
    for value in (3.1, math.nan, True, "3", None, [3]):
        with pytest.raises(DocumentError, match=r"^x: "):
            read_number(value, "x", 0.0, 3.0)


TOO_DEEP = DEPTH_MAX + 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not JSON"),
        ("[]", "not a JSON object"),
        ('{"a": 1, "a": 1}', "key 'a' is given twice"),
        ('{"b": [{"a": 1, "a": 2}]}', "key 'a' is given twice"),
        ('{"\\ud800": 1, "\\ud801": 2}', "is given twice"),  # both are stored as U+FFFD
        ('{"a": NaN}', "NaN is not JSON"),
        ('{"a": -Infinity}', "-Infinity is not JSON"),
        ('{"a": 1e999}', "1e999 is too large"),
        (f'{{"a": {"9" * 301}}}', "a whole number of 301 digits"),
        (f'{{"a": {"[" * TOO_DEEP + "]" * TOO_DEEP}}}', "nested too deep"),
        ('{"a":' * 100_000, "nested too deep"),
        ("[" * 100_000, "nested too deep"),
        ("{" + " " * SMALL + "}", "larger than 1024 kB"),
        (b"\xff\xfe\x00", "not JSON"),
    ],
)
def test_json_that_no_document_may_be_is_refused(text: str | bytes, says: str) -> None:
    with pytest.raises(DocumentError, match=r"^a\.json: ") as refusal:
        parse_json(text, "a.json")
    assert says in str(refusal.value)


def test_yaml_that_is_too_long_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(DocumentError, match="larger than 128 kB"):
        parse_yaml("#" * (YAML + 1))


def test_a_file_that_cannot_be_read_is_the_same_error(tmp_path: Path) -> None:
    for reader in (read_json, read_yaml):
        with pytest.raises(DocumentError, match=r"none\.x: cannot be read: No such file"):
            reader(Bicycle, tmp_path / "none.x")
        with pytest.raises(DocumentError, match="cannot be read: not a regular file"):
            reader(Bicycle, tmp_path)


# Documents of any shape, near to one that is right and far from it.

KEYS = st.sampled_from(
    ["format", "wheels", "size_m", "spokes", "colour", "from", "gears", "g1", "span", "at"]
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from([1, "red", "08:00", 10**400]),
)
DOCUMENTS = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(KEYS | st.text(max_size=4), inner, max_size=6)
    ),
    max_leaves=25,
)


def all_numbers_are_finite(value: object) -> bool:
    if isinstance(value, Bicycle):
        return all(0.0 < wheel.size_m <= 2.0 and wheel.spokes >= 3 for wheel in value.wheels) and all(
            math.isfinite(number) for number in (*value.gears.values(), *(value.span or ()))
        )
    return False


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(DOCUMENTS)
def test_any_values_are_a_document_or_that_one_error(document: object) -> None:
    for candidate in (document, {**GOOD, "wheels": document}, {**GOOD, "gears": document, "span": document}):
        try:
            found = read(Bicycle, candidate)
        except DocumentError as error:
            assert error.problems
            assert str(error).isprintable()
        else:
            assert all_numbers_are_finite(found)


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(st.one_of(st.text(), st.binary(), DOCUMENTS.map(json.dumps)))
def test_any_json_text_is_a_document_or_that_one_error(text: str | bytes) -> None:
    with suppress(DocumentError):
        read(Bicycle, parse_json(text))


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.one_of(st.text(), DOCUMENTS.map(lambda document: yaml.safe_dump(document, allow_unicode=True))))
def test_any_yaml_text_is_a_document_or_that_one_error(text: str) -> None:
    with suppress(DocumentError):
        read(Bicycle, parse_yaml(text), null_is_empty=True)
