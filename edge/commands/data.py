"""`greenhouse data look FILE...` and `greenhouse data convert FILE...`: logs of another box as run files."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from edge.commands.arguments import writing
from edge.core.errors import RequestError
from edge.core.plain_text import plain
from edge.data_intake.look import UNKNOWN, LogLook
from edge.formats.atomic_file import make_folder

HEIGHT_IN = 1.1  # of a column's strip


def draw(found: LogLook, path: Path) -> None:
    """Columns that are taken for something. Errors: RequestError without matplotlib; OSError"""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise RequestError("a picture needs matplotlib: pip install matplotlib") from None
    shown = [
        (target, source) for target, source in found.mapping.columns.items() if source.column in found.values
    ]
    figure = Figure(figsize=(9, 0.8 + HEIGHT_IN * max(len(shown), 1)), layout="constrained")
    strips = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    hours = (found.time_s - found.time_s[0]) / 3600.0
    for strip, (target, source) in zip(strips, shown, strict=False):
        strip.plot(hours, found.values[source.column], linewidth=0.9)
        strip.set_title(f"{source.column} as {target}, in {source.unit}", fontsize="small", loc="left")
    strips[-1].set_xlabel("time [h]")
    figure.savefig(path, dpi=110)


NAME, EXAMPLE = 24, 20  # characters of a cell of the table


def look_text(found: LogLook, paths: Sequence[Path], place: Path) -> str:
    """Return a table of the columns and guesses, and the next steps."""
    return "\n".join(_lines(found, paths, place)) + "\n"


def _lines(found: LogLook, paths: Sequence[Path], place: Path) -> Iterator[str]:
    layout = found.mapping.layout
    files = "1 file" if len(paths) == 1 else f"{len(paths)} files"
    cut = _layout(layout.delimiter, layout.decimal)
    yield f"{files}, {found.rows} rows, usually {found.step_s:g} s apart; {cut}"
    yield _row("column", "first value", "lowest", "highest", "missing", "taken for")
    for column in found.columns:
        low, high = ("" if value is None else f"{value:.5g}" for value in (column.low, column.high))
        yield _row(column.name, column.example, low, high, str(column.missing), column.meaning or "-")
    if found.mapping.guesses:
        yield "Guesses, to be read:"
    for where, why in found.mapping.guesses.items():
        yield f"  {where}: {why}"
    yield f"Mapping: {place}"
    if any(source.column == UNKNOWN for source in found.mapping.columns.values()):
        yield f"Put the names in the place of {UNKNOWN!r}, then:"
    names = " ".join(plain(str(path), 200) for path in paths[:3]) + (" ..." if len(paths) > 3 else "")
    yield f"  greenhouse data convert {names} --map {place} --out runs/"


def _row(name: str, example: str, low: str, high: str, missing: str, meaning: str) -> str:
    ours = f"{_cut(name, NAME):<{NAME}}{_cut(example, EXAMPLE):<{EXAMPLE}}"
    return f"{ours}{low:>10}{high:>10}{missing:>9}  {meaning}"


def _layout(delimiter: str, decimal: str) -> str:
    if not delimiter:
        return "a spreadsheet"
    names = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "bars"}
    return (
        f"{names.get(delimiter, delimiter)} between cells, decimal {'comma' if decimal == ',' else 'point'}"
    )


def _cut(text: str, length: int) -> str:
    clean = plain(text, 200)
    return clean if len(clean) < length else clean[: length - 2] + "… "


ACTIONS = ("look", "convert")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    looks = actions.add_parser(
        "look",
        help="say what a log seems to hold, as a mapping to edit",
        description="Say what a CSV or XLSX log seems to hold, write that as a mapping to edit, and draw it.",
    )
    looks.add_argument("files", type=Path, nargs="+", metavar="FILE", help="CSV, TSV or XLSX with one header")
    looks.add_argument(
        "--map", type=Path, default=Path("map.yaml"), help="file to write; default: %(default)s"
    )
    looks.add_argument("--picture", type=Path, help="file to draw the columns into, such as look.png")
    looks.set_defaults(run_action=_look)
    converts = actions.add_parser(
        "convert",
        help="write run files from logs, by a mapping",
        description="Write run files from logs, by a mapping; split where rows are missing.",
    )
    converts.add_argument("files", type=Path, nargs="+", metavar="FILE", help="as `data look` has seen them")
    converts.add_argument("--map", type=Path, required=True, help="mapping of `data look`, corrected")
    converts.add_argument("--out", type=Path, required=True, help="folder for the run files")
    converts.set_defaults(run_action=_convert)


def run(arguments: argparse.Namespace) -> int:
    """0. Errors: DataError, RequestError"""
    return int(arguments.run_action(arguments))


def _look(arguments: argparse.Namespace) -> int:
    from edge.commands.data import draw, look_text
    from edge.data_intake.look import look
    from edge.data_intake.mapping import write_map

    found = look(arguments.files)
    with writing(arguments.map):
        write_map(found.mapping, arguments.map)
    print(look_text(found, arguments.files, arguments.map), end="")
    if arguments.picture is not None:
        with writing(arguments.picture):
            draw(found, arguments.picture)
        print(f"Picture: {arguments.picture}")
    return 0


def _convert(arguments: argparse.Namespace) -> int:
    from edge.data_intake.convert import convert
    from edge.data_intake.mapping import read_map

    mapping = read_map(arguments.map)
    with writing(arguments.out):
        make_folder(arguments.out)
        for path in arguments.files:
            for place, rows in convert(path, mapping, arguments.out):
                print(f"{place}: {rows} rows")
    return 0
