"""edge/formats/parsing.py: what a hostile or careless document may cost, and what its scalars mean."""

import time

import pytest
import yaml

from edge.config import loading as config
from edge.core.errors import ConfigError
from edge.formats.parsing import DEPTH_MAX, VALUES_MAX, parse_yaml

pytestmark = pytest.mark.slow

BOMB = "a: &a [1]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefghi", "bcdefghij", strict=True)
)


@pytest.mark.parametrize(
    ("source", "why"),
    [
        (BOMB, "values"),
        ("a: &a [*a]", "alias inside"),
        ("[" * 5000, "nested too deep"),
        ("[" * (DEPTH_MAX + 1) + "]" * (DEPTH_MAX + 1), "nested too deep"),
        ("- 1\n" * VALUES_MAX, "values"),
        ("9" * 400, "400 digits"),
        ("9" * 5000, "5000 digits"),
        ("!!int x", "tag"),
        ("!!timestamp x", "tag"),
        ("!!python/object/apply:os.system [id]", "tag"),
        ("board: {port: a, port: b}", "key 'port' is given twice"),
        ("board: 1\nboard: 2", "key 'board' is given twice"),
        (f"{{{'x' * 900}: 1, {'x' * 900}: 1}}", "twice"),
    ],
)
def test_a_hostile_document_is_refused_in_one_short_line(source: str, why: str) -> None:
    begun_s = time.process_time()
    with pytest.raises(yaml.YAMLError, match=why) as caught:
        parse_yaml(source)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
    assert time.process_time() - begun_s < 10.0


def test_numbers_and_flags_are_those_that_a_person_means() -> None:
    assert parse_yaml("[08, 010, +7, -007]") == [8, 10, 7, -7]
    assert parse_yaml("[4e1, 1e-3]") == [40.0, 0.001]  # an exponent needs no point
    assert parse_yaml("[true, yes, on, off, no]") == [True, "yes", "on", "off", "no"]


def test_an_alias_of_modest_size_is_taken() -> None:
    assert parse_yaml("a: &a [1, 2]\nb: *a\n") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize("text", ["\\0", "\\ud800", "\\e[2J", "a" * 5000])
def test_a_text_that_no_path_can_be_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"history.path: .* not printable") as caught:
        config.parse(f'history: {{path: "{text}"}}')
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300


def test_a_value_of_a_bomb_is_quoted_in_a_few_characters() -> None:
    source = "\n".join(BOMB.splitlines()[:4]) + "\ncontrol: *d\n"
    with pytest.raises(ConfigError, match=r"control: must hold keys and values, not \[\[\[\[1\], ") as caught:
        config.parse(source)
    (line,) = (line for line in str(caught.value).splitlines() if ": control: " in line)
    assert len(line) < 300
