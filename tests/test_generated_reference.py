"""The manual's generated Reference holds what the code has."""

import pytest

from tools import reference
from tools.reference import PAGES, command_names, variables_of


def test_the_reference_holds_every_command_and_variable() -> None:
    """Its pages are made anew; a column, topic, command or variable that nothing is said of is refused."""
    pages = {name: page() for name, page in PAGES.items()}
    for command in command_names():
        assert f"### greenhouse {command}\n" in pages["commands.md"]
    assert "| `control.penalty_weight`" not in pages["settings.md"]
    assert "| `penalty_weight` | `1.0` | 1 | 0 to 1e+06 |" in pages["settings.md"]


def test_a_name_without_words_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(reference.words.TABLES, "ticks")
    with pytest.raises(KeyError, match="without words: \\['ticks'\\]"):
        reference.history()


def test_variables_are_found_as_they_are_read() -> None:
    source = 'os.environ.get("AB_C", ""); os.environ["DE"] = "1"; x = os.environ | {"NO": 1}'
    assert variables_of(source) == {"AB_C", "DE"}
