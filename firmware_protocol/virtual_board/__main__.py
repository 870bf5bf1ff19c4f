"""Run a board made of software behind a pseudo-terminal; README.md beside this file says how."""

import argparse
import contextlib
import importlib
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_protocol.messages import Capability, ResetCause
from firmware_protocol.virtual_board.board_config import RIG_PARTS, BoardConfig
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.core import BoardCore
from firmware_protocol.virtual_board.device import Boot, Core, Device
from firmware_protocol.virtual_board.faults import FaultError, read_script
from firmware_protocol.virtual_board.plant import Plant
from firmware_protocol.virtual_board.port import PseudoTerminal
from firmware_protocol.virtual_board.server import Server
from firmware_protocol.virtual_board.store import Eeprom, StoreError


class PathInUse(Exception):
    """The path belongs to a living board, or is none of ours."""


def claim(path: Path) -> socket.socket:
    """Own `path` for as long as the socket returned lives, and clear it of a dead board's rest.

    The kernel frees an abstract socket name when its process ends, however that was; a lock file would stay.
    Errors: PathInUse.
    """
    owner = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        owner.bind(f"\0virtual_board:{path.absolute()}")
    except OSError as error:
        owner.close()
        raise PathInUse(f"{path}: in use by a running board") from error
    if path.is_symlink() or path.is_socket():
        path.unlink()
    elif path.exists():
        owner.close()
        raise PathInUse(f"{path}: there is a file that no board has made")
    return owner


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until SIGTERM, SIGINT or a `quit`; the exit code."""
    options = _parser().parse_args(arguments)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: sys.exit(0))
    try:
        with contextlib.ExitStack() as stack:
            for path in (options.link, options.control):
                stack.enter_context(claim(path))
            device = _device(options)
            server = Server(
                device, PseudoTerminal(options.link), options.control, options.seed, options.real_time
            )
            stack.callback(server.close)
            server.run()
    except (FaultError, PathInUse, StoreError, ValueError, OSError, RuntimeError) as error:
        print(f"virtual board: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m firmware_protocol.virtual_board", description=__doc__)
    parser.add_argument("--link", type=Path, required=True, help="symlink to make to the serial port")
    parser.add_argument("--control", type=Path, required=True, help="Unix socket to listen on")
    parser.add_argument(
        "--core",
        default="python",
        help="python, or MODULE:FUNCTION of another one",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the chamber and of the faults")
    parser.add_argument("--real-time", action="store_true", help="else time moves only when told")
    parser.add_argument("--faults", type=Path, help="YAML list of faults")
    parser.add_argument("--chamber", type=Path, help="YAML that changes parameters or effects of the box")
    parser.add_argument("--state", type=Path, help="file that keeps trip and boot count")
    parser.add_argument("--fan-safe-on", action="store_true", help="the fan runs without a host")
    names = [part.name.lower() for part in Capability if part.name]
    for option, what in (("--with", "it has this part, e.g. heater_cutoff"), ("--without", "it has not")):
        parser.add_argument(option, dest=option, choices=names, action="append", default=[], help=what)
    return parser


def _device(options: argparse.Namespace) -> Device:
    parts = (RIG_PARTS | _parts(options, "--with")) & ~_parts(options, "--without")
    plant = Plant(Chamber(*load(options.chamber), options.seed), parts)
    config = BoardConfig(capabilities=parts, fan_safe_on=options.fan_safe_on)
    faults = [] if options.faults is None else read_script(options.faults, options.seed)
    return Device(_boot(options.core, config), plant, Eeprom(options.state), faults)


def _parts(options: argparse.Namespace, option: str) -> Capability:
    parts = Capability(0)
    for name in getattr(options, option):
        parts |= Capability[name.upper()]
    return parts


def _boot(core: str, config: BoardConfig) -> Boot:
    module, _, function = core.partition(":")
    if function:
        made: Boot = getattr(importlib.import_module(module), function)(config)
        return made
    if core != "python":
        raise ValueError(f"--core {core}: neither python nor MODULE:FUNCTION")

    def boot(persistent: bytes, cause: ResetCause, boot_count: int) -> Core:
        return BoardCore(config, persistent, cause, boot_count)

    return boot


if __name__ == "__main__":
    sys.exit(main())
