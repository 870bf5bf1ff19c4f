"""Write a twin file for a box, from what can be measured by hand; what is not known is fitted to the runs."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path

from edge.commands.arguments import writing
from edge.core.errors import RequestError
from edge.formats.atomic_file import write_atomically
from edge.twin.new_file import CONDUCTIVITY_W_M_K, BoxDescription, check, text
from edge.twin.twin_file import FAN_ROLES, read_twin_file

NUMBER = r"(\d+\.?\d*|\.\d+)"
LITRES, METRES = {"l": 1e-3, "m3": 1.0}, {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the action."""
    parser.add_argument("file", type=Path, help="twin file to write")
    size = parser.add_mutually_exclusive_group(required=True)
    size.add_argument(
        "--volume", type=_in(LITRES), dest="volume_m3", help="of the air, such as 27l or 0.15m3"
    )
    size.add_argument("--edges", type=_edges, dest="volume_m3", help="of the box inside, such as 50x50x60cm")
    parser.add_argument("--heater-w", type=float, required=True, help="power of the heater at full duty [W]")
    parser.add_argument(
        "--fan", choices=FAN_ROLES, required=True, help="what it does: change the air, mix it"
    )
    parser.add_argument("--fan-flow", type=float, help="of an exhaust fan that runs free [m3/h]")
    parser.add_argument("--wall", type=_wall, help="material and thickness, such as plywood:12mm")
    parser.add_argument("--wall-area", type=float, help="of all walls, floor and lid [m2]")
    parser.add_argument("--sample-s", type=float, default=60.0, help="step of the twin; default: %(default)s")
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


def _in(units: dict[str, float]) -> Callable[[str], float]:
    def read(word: str) -> float:
        match = re.fullmatch(rf"{NUMBER}({'|'.join(units)})", word)
        if match is None:
            raise argparse.ArgumentTypeError(f"{word!r} is no number with its unit, {' or '.join(units)}")
        return float(match[1]) * units[match[2]]

    return read


def _edges(word: str) -> float:
    match = re.fullmatch(rf"{NUMBER}x{NUMBER}x{NUMBER}({'|'.join(METRES)})", word)
    if match is None:
        raise argparse.ArgumentTypeError(f"{word!r} is not like 50x50x60cm")
    return float(match[1]) * float(match[2]) * float(match[3]) * METRES[match[4]] ** 3


def _wall(word: str) -> tuple[str, float]:
    material, _, thickness = word.partition(":")
    if material not in CONDUCTIVITY_W_M_K:
        raise argparse.ArgumentTypeError(f"{material!r} is none of {', '.join(CONDUCTIVITY_W_M_K)}")
    return material, _in(METRES)(thickness)
