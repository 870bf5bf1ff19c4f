"""A virtual board as a child process, for `greenhouse demo` and `greenhouse experiment --virtual`."""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from edge.config.settings import BoxSettings, Settings
from edge.core.errors import GreenhouseError
from edge.core.names import HEATER_MAX_W
from edge.core.processes import die_with_parent, end_process

BOARD = "board"  # name of its port
START_PATIENCE_S = 60.0  # real time; a single-board computer that unpacks a package meanwhile imports slowly


@dataclass(frozen=True, slots=True)
class VirtualRig:
    """The addresses of the virtual board."""

    port: Path
    control: Path


def settings_in(folder: Path, settings: Settings) -> Settings:
    """Return settings of the same rig with its board and all files in a folder and
    no broker, so that no real one is touched.
    """
    return replace(
        settings,
        state_file=str(folder / "state.json"),
        board=replace(settings.board, port=str(folder / BOARD)),
        control_socket=replace(settings.control_socket, path=str(folder / "control.sock")),
        history=replace(settings.history, path=str(folder / "history.db")),
        page=replace(settings.page, folder=str(folder / "page")),
        bundle=replace(settings.bundle, path=str(folder / "bundles"), trusted_keys=str(folder / "keys")),
        drift=replace(settings.drift, reports=str(folder / "diagnoses")),
        mqtt=replace(settings.mqtt, enabled=False),
        box=settings.box if settings.box != BoxSettings() else BoxSettings(heater_w=HEATER_MAX_W),
    )


@contextmanager
def virtual_rig(folder: Path, seed: int, options: Sequence[str] = ()) -> Iterator[VirtualRig]:
    """Start the board, wait until it answers, and surely end it. Errors: GreenhouseError with its output."""
    rig = VirtualRig(folder / BOARD, folder / "board.sock")
    log = folder / "board.log"
    program = [sys.executable, "-m", "firmware_protocol.virtual_board"]
    places = ["--link", str(rig.port), "--control", str(rig.control), "--seed", str(seed)]
    with log.open("w") as out:
        # A session of its own: Ctrl-C is for the daemon, which still needs the board to turn the heater off.
        process = subprocess.Popen(
            [*program, *places, *options],
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
    try:
        _wait_until_ready(process, rig, log)
        yield rig
    finally:
        end_process(process, patience_s=5.0)


def _wait_until_ready(process: "subprocess.Popen[bytes]", rig: VirtualRig, log: Path) -> None:
    give_up = time.monotonic() + START_PATIENCE_S
    while not (rig.control.exists() and rig.port.exists()):
        if process.poll() is not None:
            raise GreenhouseError(f"the virtual board did not start: {log.read_text().strip()}")
        if time.monotonic() > give_up:
            raise GreenhouseError(f"the virtual board was not ready within {START_PATIENCE_S:g} s")
        time.sleep(0.02)
