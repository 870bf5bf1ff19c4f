"""`greenhouse board check FILE`, `greenhouse board wiring FILE --out PICTURE`: a board.yaml and its wires."""

import argparse
from pathlib import Path

from edge.board.board_file import read_board_file
from edge.board.wiring import wiring_svg, wiring_table
from edge.commands.arguments import writing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    helps = {
        "check": "read a board.yaml and print every wire that it means",
        "wiring": "draw the wires of a board.yaml as an SVG picture",
    }
    check, wiring = (
        actions.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        for name, text in helps.items()
    )
    for sub in (check, wiring):
        sub.add_argument("file", type=Path, metavar="FILE", help="the board.yaml")
    wiring.add_argument("--out", type=Path, required=True, metavar="PICTURE", help="where the SVG is written")


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError for a wrong file, RequestError"""
    block = read_board_file(arguments.file)
    if arguments.action == "check":
        print("\n".join(wiring_table(block).text()), end="")
        return 0
    with writing(arguments.out):
        arguments.out.write_text(wiring_svg(block), encoding="utf-8")
    print(f"{arguments.out}: the wires of {arguments.file}")
    return 0
