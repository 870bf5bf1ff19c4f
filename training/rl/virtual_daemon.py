"""The daemon on a virtual board, asking whoever connects: `python -m training.rl.virtual_daemon FOLDER`.

A process of its own for a learner on the same machine. Everything it writes is in FOLDER; it asks at
FOLDER/external.sock. It ends on SIGTERM, and with the process that started it.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import ExternalSettings
from edge.core.controller_names import EXTERNAL
from edge.core.errors import GreenhouseError
from edge.core.processes import die_with_parent, end_process
from edge.lab.episodes import EpisodeSettings, draw_reference
from edge.tick.reference import Reference
from training.lab import Lab

SOCKET = "external.sock"
CLIENT_WAIT_S = 120.0  # a learner imports torch first
START_PATIENCE_S = 60.0
HOURS = 48
ROOM_C = 22.0  # about the virtual board's; references are drawn for it


def drawn_reference(seed: int, hours: float = HOURS) -> Reference:
    """Draw a random course, as in training; the last value holds on."""
    steps = round(60 * hours)
    values = draw_reference(np.random.default_rng(seed), EpisodeSettings(steps=steps), ROOM_C)
    return Reference(60.0 * np.arange(steps, dtype=np.float64), values)


def serve(folder: Path, seed: int, speed: float | None) -> None:
    """Run until stopped. speed : simulated seconds per second, None: as fast as it goes"""
    settings = settings_in(folder, config.default())
    settings = replace(
        settings,
        bundle=replace(settings.bundle, path=""),  # its models only watch, and take most of a tick's time
        drift=replace(settings.drift, enabled=False),
        control=replace(settings.control, controller=EXTERNAL),
        external=ExternalSettings(str(folder / SOCKET)),
    )
    reference = drawn_reference(seed)
    with Lab(
        settings,
        seed=seed,
        folder=folder,
        speed=speed,
        reference=reference,
        client_wait_s=CLIENT_WAIT_S,
    ) as lab:
        lab.run()


@contextmanager
def virtual_daemon(folder: Path, seed: int, speed: float | None = None) -> Iterator[Path]:
    """Run the daemon as a child process that surely ends, and yield its socket.
    Errors: GreenhouseError with its output
    """
    log, where = folder / "daemon.log", folder / SOCKET
    words = [sys.executable, "-m", "training.rl.virtual_daemon", str(folder), "--seed", str(seed)]
    words += [] if speed is None else ["--speed", str(speed)]
    with log.open("w") as out:
        process = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT, preexec_fn=die_with_parent)
    try:
        give_up_s = time.monotonic() + START_PATIENCE_S
        while not where.exists():
            if process.poll() is not None or time.monotonic() > give_up_s:
                raise GreenhouseError(f"the daemon on the virtual board did not start: {log.read_text()}")
            time.sleep(0.05)
        yield where
    finally:
        end_process(process, patience_s=30.0)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m training.rl.virtual_daemon", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1, help="of the virtual board and of the reference")
    parser.add_argument("--speed", type=float, help="simulated seconds per second; as fast as it goes")
    arguments = parser.parse_args(words)
    serve(arguments.folder, arguments.seed, arguments.speed)


if __name__ == "__main__":
    main()
