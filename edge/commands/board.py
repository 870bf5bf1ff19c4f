"""`greenhouse board`: check and draw a board.yaml; look at a board, configure it, flash it."""

import argparse
from pathlib import Path

from edge.board.board_file import BOARDS, read_board_file
from edge.board.board_session import BAUDRATE, BoardSession
from edge.board.board_tool import configuration, configure, flash, show
from edge.board.wiring import wiring_svg, wiring_table
from edge.commands.arguments import add_actions, whole, writing
from edge.commands.orders import print_answer
from edge.commands.which_rig import add_socket, socket_of
from edge.config.settings import BoardSettings
from edge.formats.atomic_file import write_atomically
from edge.sockets.client import request

HELPS = {
    "check": "read a board.yaml and print every wire that it means",
    "wiring": "draw the wires of a board.yaml as an SVG picture",
    "show": "print a board's program, configuration, wires and present values",
    "accept": "let the running daemon drive the board that is at its port now",
    "configure": "write a board.yaml into a board over its line; refused while the heater is driven",
    "flash": "write this version's program into an Arduino by avrdude",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    subs = add_actions(parser, HELPS)
    for name in ("check", "wiring", "configure"):
        subs[name].add_argument("file", type=Path, metavar="FILE", help="the board.yaml")
    subs["wiring"].add_argument(
        "--out", type=Path, required=True, metavar="PICTURE", help="where the SVG is written"
    )
    subs["show"].add_argument("--wiring", type=Path, metavar="PICTURE", help="draw its wires as an SVG too")
    for name in ("show", "configure", "flash"):
        subs[name].add_argument(
            "--port", default=BoardSettings().port, help="serial port (default: %(default)s)"
        )
    add_socket(subs["accept"])
    subs["flash"].add_argument("--board", required=True, choices=BOARDS, help="the microcontroller's board")
    subs["flash"].add_argument(
        "--baudrate", type=whole(1), default=BAUDRATE, help="of the bootloader; 57600 for an old Nano"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError for a wrong file, RequestError"""
    match arguments.action:
        case "check":
            print("\n".join(wiring_table(read_board_file(arguments.file)).text()), end="")
        case "wiring":
            _draw(wiring_svg(read_board_file(arguments.file)), arguments.out)
        case "show":
            with BoardSession(arguments.port) as session:
                print("\n".join(show(session)))
                if arguments.wiring is not None:
                    _draw(wiring_svg(configuration(session)), arguments.wiring)
        case "accept":
            return print_answer(request(socket_of(arguments), {"do": "accept_board"}))
        case "configure":
            block = read_board_file(arguments.file)
            with BoardSession(arguments.port) as session:
                print("\n".join(configure(session, block)))
        case _:
            for line in flash(arguments.board, arguments.port, arguments.baudrate):
                print(line, flush=True)
    return 0


def _draw(picture: str, out: Path) -> None:
    with writing(out):
        write_atomically(out, picture)
    print(f"{out}: the wires")
