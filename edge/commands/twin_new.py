"""Write a twin file for a box, from what can be measured by hand; what is not known is fitted to the runs."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge.commands.arguments import number, writing
from edge.core.errors import RequestError
from edge.formats.atomic_file import write_atomically
from edge.twin.box_words import VOLUME, edges, quantity, wall
from edge.twin.new_file import BoxDescription, check, text
from edge.twin.twin_file import FAN_ROLES, read_twin_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the action."""
    parser.add_argument("file", type=Path, help="twin file to write")
    size = parser.add_mutually_exclusive_group(required=True)
    size.add_argument(
        "--volume",
        type=_option_type(lambda word: quantity(word, VOLUME)),
        dest="volume_m3",
        help="of the air, such as 27l or 0.15m3",
    )
    size.add_argument(
        "--edges", type=_option_type(edges), dest="volume_m3", help="of the box inside, such as 50x50x60cm"
    )
    value = number(0.0, 1e9)
    parser.add_argument("--heater-w", type=value, required=True, help="power of the heater at full duty [W]")
    parser.add_argument(
        "--fan", choices=FAN_ROLES, required=True, help="what it does: change the air, mix it"
    )
    parser.add_argument("--fan-flow", type=value, help="of an exhaust fan that runs free [m3/h]")
    parser.add_argument(
        "--wall", type=_option_type(wall), help="material and thickness, such as plywood:12mm"
    )
    parser.add_argument("--wall-area", type=value, help="of all walls, floor and lid [m2]")
    parser.add_argument("--sample-s", type=value, default=60.0, help="step of the twin; default: %(default)s")
    parser.add_argument("--force", action="store_true", help="replace a file that is there")


def run(arguments: argparse.Namespace) -> int:
    """0. Errors: RequestError for numbers that can't be, DataError for a file that can't be written"""
    if arguments.file.exists() and not arguments.force:
        raise RequestError(f"{arguments.file}: is there already; --force replaces it")
    box = BoxDescription(
        arguments.volume_m3,
        arguments.heater_w,
        arguments.fan,
        arguments.fan_flow,
        arguments.wall_area,
        arguments.wall,
        arguments.sample_s,
    )
    check(box)
    with writing(arguments.file):
        write_atomically(arguments.file, text(box))
    read_twin_file(arguments.file)
    print(f"{arguments.file}: written. Next:")
    print(f"  greenhouse twin diagnose RUN... --twin {arguments.file} --out report/")
    return 0


def _option_type(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return the type of an option whose refusal argparse shows."""

    def convert(word: str) -> Any:
        try:
            return read(word)
        except RequestError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert
