"""python -m bench.card_writes: bytes that a day of the daemon at its default settings writes to its card.

The state folder is an ext4 file system of its own on a loop device. The kernel counts the sectors that reach
the device, so that journal, file system and write-backs are in the figure. The system's log is not: journald
writes to another folder, and Raspberry Pi OS and Debian hold it in memory or on the disk as configured.

In real time the daemon runs as its service does, and the rest of the day is scaled. In the accelerated day
each of the 1440 ticks is a transaction of its own, as in real time, but the kernel's write-backs by time
(every 5 s and 30 s) come seldom. Needs root, for the mount.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from bench.header import header
from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.core.messages import TickRecord
from edge.core.processes import end_process
from tests.support.daemon_process import ROOT, run_command
from tests.support.virtual_board import virtual_board
from training.lab import Lab

CARD_MB = 256
BLOCK_BYTES = "4096"  # as on a card; a file system as small as this one would have blocks of 1024
SECTOR_BYTES = 512  # of /sys/block/*/stat, whatever the device's own are
DAY_S = 86_400.0
SETTLE_S = 120.0  # the first start makes the files; the kernel's write-backs of them come within 35 s
TARGET_MB = 30.0  # a day


@dataclass(frozen=True, slots=True)
class Card:
    """A mounted file system of its own, and the device below it."""

    folder: Path
    device: str

    def written_mb(self) -> float:
        """Return what the device has been given since it was made, dirty pages included [MB]."""
        os.sync()
        sectors = Path(f"/sys/block/{self.device}/stat").read_text().split()[6]
        return int(sectors) * SECTOR_BYTES / 1e6


@contextmanager
def card() -> Iterator[Card]:
    """Make a card, mount it, take both away. Errors: RequestError without root"""
    if os.geteuid() != 0:
        raise RequestError("bench.card_writes: mounts a file system: run it as root")
    with tempfile.TemporaryDirectory(prefix="gh-card-") as name:
        image, folder = Path(name) / "card.img", Path(name) / "card"
        folder.mkdir()
        with image.open("wb") as file:
            file.truncate(CARD_MB << 20)
        options = "lazy_itable_init=0,lazy_journal_init=0"  # nothing is left to initialise later
        _output("mkfs.ext4", "-q", "-b", BLOCK_BYTES, "-E", options, str(image))
        device = _output("losetup", "--find", "--show", str(image))
        try:
            _output("mount", "-o", "noatime", device, str(folder))  # as Raspberry Pi OS mounts it
            try:
                yield Card(folder, Path(device).name)
            finally:
                _output("umount", str(folder))
        finally:
            _output("losetup", "--detach", device)


def _output(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def default_settings(place: Card, board: Path) -> Settings:
    """Return the default settings with their files on the card and a virtual board's port."""
    settings = settings_in(place.folder, config.default())
    return replace(settings, board=replace(settings.board, port=str(board)))


def accelerated_mb(ticks: int, speed: float) -> float:
    """Return what `ticks` steps write, at `speed` simulated seconds a second [MB]."""
    with card() as place:
        settings = settings_in(place.folder, config.default())
        first, begin = round(SETTLE_S / settings.control.step_s), 0.0

        def look(record: TickRecord) -> None:
            nonlocal begin
            if record.seq == first:
                begin = place.written_mb()

        with tempfile.TemporaryDirectory(prefix="gh-") as name, virtual_board(Path(name)) as board:
            settings = replace(settings, board=replace(settings.board, port=str(board.port)))
            lab = Lab(settings, board=board.control, folder=place.folder, speed=speed, on_tick=look)
            with lab:
                lab.run(ticks=first + ticks)
        return place.written_mb() - begin


def real_mb(minutes: float) -> float:
    """Return what the daemon writes in so many minutes after its start has settled [MB]."""
    with card() as place, tempfile.TemporaryDirectory(prefix="gh-") as name:
        folder = Path(name)
        with virtual_board(folder, "--real-time") as board:
            settings = default_settings(place, board.port)
            file = folder / "edge.yaml"
            file.write_text(yaml.safe_dump(_document(settings)))
            with (folder / "log").open("wb") as log:
                process = subprocess.Popen(run_command(file), stdout=log, stderr=log, cwd=ROOT)
            try:
                time.sleep(SETTLE_S)
                begin = place.written_mb()
                time.sleep(60.0 * minutes)
                if process.poll() is not None:
                    raise RequestError(f"the daemon ended: {(folder / 'log').read_text()}")
                return place.written_mb() - begin
            finally:
                end_process(process, patience_s=15.0)


def _document(settings: Settings) -> dict[str, object]:
    """Return the keys that differ from the defaults."""
    return {
        "state_file": settings.state_file,
        "board": {"port": settings.board.port},
        "control_socket": {"path": settings.control_socket.path},
        "history": {"path": settings.history.path},
        "bundle": {"path": settings.bundle.path, "trusted_keys": settings.bundle.trusted_keys},
        "drift": {"reports": settings.drift.reports},
    }


def report(minutes: float, ticks: int, speed: float) -> Iterator[str]:
    """Yield the table, line by line as it comes."""
    step_s = config.default().control.step_s
    yield f"{f'default settings, steps of {step_s:g} s':44} measured [MB]  a day [MB]  a tick [kB]"
    if ticks:
        megabytes = accelerated_mb(ticks, speed)
        yield _row(f"{ticks} ticks at {speed:g} times real time", megabytes, DAY_S / step_s / ticks)
    if minutes:
        megabytes = real_mb(minutes)
        yield _row(f"{minutes:g} minutes in real time", megabytes, DAY_S / 60.0 / minutes)
    yield f"target: at most {TARGET_MB:g} MB a day"


def _row(text: str, megabytes: float, share: float) -> str:
    ticks = DAY_S / config.default().control.step_s
    return f"{text:44} {megabytes:13.2f} {megabytes * share:11.1f} {1e3 * megabytes * share / ticks:12.1f}"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.card_writes", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="in real time; 0: not measured")
    parser.add_argument("--ticks", type=int, default=1440, help="of the accelerated day; 0: not measured")
    parser.add_argument("--speed", type=float, default=300.0, help="of the accelerated day")
    arguments = parser.parse_args()
    print(f"python -m bench.card_writes {' '.join(sys.argv[1:])}".rstrip())
    print("\n".join(header()))
    for line in report(arguments.minutes, arguments.ticks, arguments.speed):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
