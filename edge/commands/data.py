"""`greenhouse data look FILE...` and `greenhouse data convert FILE...`: logs of another box as run files."""

import argparse
from pathlib import Path

from edge.commands.output import writing

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
    from edge.data_intake.look import look
    from edge.data_intake.mapping import write_map
    from edge.data_intake.pictures import draw
    from edge.data_intake.words import look_text

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
        arguments.out.mkdir(parents=True, exist_ok=True)
        for path in arguments.files:
            for place, rows in convert(path, mapping, arguments.out):
                print(f"{place}: {rows} rows")
    return 0
