"""edge/formats/table.py: one table as text, as HTML and as Markdown."""

from edge.formats.table import Table

TABLE = Table("A < B", ("name", "x"), (("long name", "1"),), "note")


def test_names_stand_to_the_left_and_figures_to_the_right() -> None:
    assert list(TABLE.text()) == ["A < B", "name       x", "long name  1", "note", ""]


def test_words_stand_to_the_left_and_leave_no_blanks_behind() -> None:
    table = Table("", ("name", "found"), (("a", "b"),), words=True)
    assert list(table.text()) == ["name  found", "a     b", ""]


def test_html_escapes_every_text() -> None:
    lines = list(TABLE.html())
    assert lines[:2] == ["<h3>A &lt; B</h3><table>", "<tr><th>name</th><th>x</th></tr>"]
    assert lines[-2:] == ["</table>", "<p class=note>note</p>"]


def test_markdown_has_a_rule_below_the_heads() -> None:
    assert list(TABLE.markdown()) == ["**A < B**", "", "| name | x |", "|---|---|", "| long name | 1 |"]
