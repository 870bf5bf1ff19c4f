"""edge/core/plain_text.py: whatever text comes, what leaves can be stored, sent and shown."""

import json
import sqlite3
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edge.core.messages import EVENT_TEXT_MAX, Event, Severity
from edge.core.plain_text import plain, quote, storable
from edge.formats.parsing import parse_object
from edge.formats.tick_json import json_value

pytestmark = pytest.mark.slow

ANY_TEXT = st.text(st.characters(exclude_categories=()))  # lone surrogates and control characters too
ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | ANY_TEXT,
    lambda inner: st.lists(inner) | st.dictionaries(ANY_TEXT, inner),
    max_leaves=20,
)


def texts(value: Any) -> list[str]:
    """Every text in a JSON value, keys among them."""
    if isinstance(value, dict):
        return [*value, *(text for item in value.values() for text in texts(item))]
    if isinstance(value, list):
        return [text for item in value for text in texts(item)]
    return [value] if isinstance(value, str) else []


@given(ANY_TEXT)
@example("\ud800")
@example("\udfff\ud800")
def test_a_storable_text_goes_into_a_database_and_comes_back(text: str) -> None:
    clean = storable(text)
    found = sqlite3.connect(":memory:").execute("SELECT ?", (clean,)).fetchone()[0]
    assert found == clean
    assert len(clean) == len(text)


@given(st.text(st.characters(exclude_categories=("C",))))
def test_a_text_without_control_characters_is_left_as_it_is(text: str) -> None:
    assert storable(text) == text


@given(ANY_TEXT)
def test_cleaning_twice_changes_nothing(text: str) -> None:
    assert storable(storable(text)) == storable(text)
    assert plain(plain(text, 20), 20) == plain(text, 20)


@given(ANY_TEXT, st.integers(4, 50))
def test_a_plain_text_is_one_printable_line_of_bounded_length(text: str, longest: int) -> None:
    line = plain(text, longest)
    assert line.isprintable()
    assert len(line) <= longest


@given(st.text("abcdefghij ", max_size=50))
def test_words_are_left_as_they_are(text: str) -> None:
    assert plain(text, 50) == " ".join(text.split())


def test_what_is_cut_says_so() -> None:
    assert plain("a" * 21, 20) == "a" * 17 + "..."
    assert plain(" " * 1000 + "hidden", 20) == "..."


@given(ANY_JSON)
def test_json_from_outside_holds_storable_texts_alone(value: Any) -> None:
    document = json.dumps({"value": value}).encode()
    try:
        found = parse_object(document)
    except ValueError as refused:  # two keys that are one once they are storable
        assert "is given twice" in str(refused)
        return
    for text in texts(found):
        assert storable(text) == text


def test_surrogates_written_as_bytes_are_cleaned_too() -> None:
    assert parse_object('{"a": "\ud800"}'.encode("utf-8", "surrogatepass")) == {"a": "\ufffd"}


@given(ANY_JSON)
def test_a_why_can_always_be_stored(why: Any) -> None:
    json.dumps(json_value(why), ensure_ascii=False, allow_nan=False).encode()


@given(ANY_TEXT)
def test_an_event_is_one_storable_line(text: str) -> None:
    event = Event("key", Severity.INFO, text, 0.0, 0.0)
    assert event.text == plain(text, EVENT_TEXT_MAX)


@pytest.mark.parametrize("value", ["\ud800" * 1000, [[["x" * 10**6]]], {"\x1b[2J": 10**4000}])
def test_a_value_in_an_error_is_short(value: Any) -> None:
    assert len(quote(value)) <= 60
    assert quote(value).isprintable()
