"""From an empty board to commissioned control: the manual's commands (docs/run-a-rig.md), one after another.

    PYTHONPATH=.:tests/firmware_protocol python tests/hardware_in_the_loop/walk_through.py

The board is an Arduino Mega in simavr: Debian's bootloader takes the program, and the same flash and EEPROM
run afterwards with simulated parts on their pins, in a chamber that their heater warms. Flash, configuration
and setup go in real time; step tests and control in the simulator's own, which a rig does not have.
`--core python` walks on the virtual board instead, which needs neither flash nor configuration.
"""

import argparse
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TextIO
from unittest import mock

import numpy as np
import yaml

from bench.header import header
from edge.__main__ import main as greenhouse
from edge.board import board_session
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import BOARD, virtual_rig
from edge.commands import commission
from edge.config import loading
from edge.config.settings import Settings
from edge.core.clock import Clock
from firmware_protocol import link
from training.lab import Lab

KIND = "mega2560"
CONTROL_MIN = 60.0
HERE = Path(__file__).parent
AVR = HERE.parent / "firmware_protocol" / "avr"
SLOW = {
    link: {"SILENCE_S": 20.0, "RETRY_S": 2.0},
    board_session: {"GREETED_S": 40.0, "ANSWERED_S": 12.0, "RESET_S": 40.0},
}
ANSWERS = {
    "volume_m3": 0.15,
    "heater_w": 100.0,
    "fan_role": "exhaust",
    "fan_m3_h": 68.0,
    "wall": "polycarbonate:8mm",
    "wall_area_m2": 1.7,
    "step_s": 60.0,
    "min_c": 15.0,
    "max_c": 35.0,
    "reference_c": 26.0,
}
PARTS = {
    "board": KIND,
    "id": 7,
    "outputs": {"heater": {"pin": "D22"}, "fan": {"pin": "D23"}, "valve": {"pin": "D24"},
                "cutoff": {"pin": "D25"}, "led": {"pin": "D6"}},
    "sensors": [
        {"part": "sht4x", "address": "0x44"},
        {"part": "ds18b20", "pin": "D30", "serial": "28-000000000001"},
        {"part": "ds18b20", "place": "outside", "pin": "D30", "serial": "28-000000000002"},
        {"part": "scd4x"},
        {"part": "bh1750", "address": "0x23", "full_lux": 40000},
        {"part": "soil", "pin": "A0", "dry": 620, "wet": 280},
        {"part": "hcsr04", "pin": "D31", "echo": "D11", "empty_mm": 400, "full_mm": 100},
    ],
}  # fmt: skip


class StepFailure(Exception):
    """A command that ended with another code than 0."""


def step(*words: object) -> None:
    """Run a command of the manual, and show it. Errors: StepFailure"""
    print("\n$ greenhouse", *words, flush=True)
    begun = time.monotonic()
    code = greenhouse([*map(str, words)])
    print(f"[{time.monotonic() - begun:.0f} s]", flush=True)
    if code != 0:
        raise StepFailure(f"greenhouse {words[0]} ended with {code}")


class ShortPaths(io.TextIOBase):
    """A stream that shows the walk's folder as a dot."""

    def __init__(self, out: TextIO, folder: Path) -> None:
        self._out, self._folder = out, str(folder)

    def write(self, text: str) -> int:
        """Pass the text on."""
        self._out.write(text.replace(self._folder, "."))
        return len(text)

    def flush(self) -> None:
        """Pass the flush on."""
        self._out.flush()


def walk(folder: Path, core: str, minutes: float, seed: int = 1) -> bool:
    """Go the whole way in `folder`; return whether the box is controlled by its own twin in the end."""
    places(folder)
    config = folder / "edge.yaml"
    options = ["--core", core]
    if core == "avr":
        eeprom = flash_and_configure(folder)
        os.environ["AVR_EEPROM"] = str(eeprom)
        options = ["--core", f"avr.avr_core:{KIND}", "--with", "heater_cutoff"]
    with patience(), virtual_rig(folder, seed, [*options, "--real-time"]):
        step("setup", "--config", config, "--from-answers", folder / "answers.json", "--replace")
    step("check-config", config)
    step("bundle", "key", folder / "rig.pem")
    (folder / "rig.pub").rename(folder / "keys" / "rig.pub")
    with virtual_rig(folder, seed, options) as rig:

        @contextmanager
        def in_its_own_time(arguments: argparse.Namespace) -> Iterator[tuple[Settings, Clock]]:
            with closing(SimClock(rig.control)) as clock:
                yield loading.load(arguments.config), clock

        with mock.patch.object(commission, "rig_of", in_its_own_time):
            words = ("--key", folder / "rig.pem", "--minutes", f"{minutes:g}", "--out", folder / "found")
            step("commission", "--config", config, *words)
        return control(folder, loading.load(config), rig.control)


def places(folder: Path) -> None:
    """Write the files that are there before the manual's first command: places, answers, parts."""
    (folder / "keys").mkdir()
    paths = {
        "state_file": str(folder / "state.json"),
        "control_socket": {"path": str(folder / "control.sock")},
        "history": {"path": str(folder / "history.db")},
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
        "drift": {"reports": str(folder / "diagnoses")},
    }
    (folder / "edge.yaml").write_text(yaml.safe_dump(paths))
    (folder / "board.yaml").write_text(yaml.safe_dump(PARTS))
    (folder / "answers.json").write_text(json.dumps({"port": str(folder / BOARD), **ANSWERS}))


@contextmanager
def patience() -> Iterator[None]:
    """Let the host wait for as long as a simulator on a busy machine takes."""
    with ExitStack() as stack:
        for module, values in SLOW.items():
            stack.enter_context(mock.patch.multiple(module, **values))
        yield


def flash_and_configure(folder: Path) -> Path:
    """Bring program and configuration into an empty Arduino; return its EEPROM's content as a file."""
    from avr.arduino import BLANK, Arduino  # late: the walk on the virtual board needs no simavr
    from avr.sensor_parts import WIRINGS

    host, blank, port = folder / "avr_host", folder / "blank.hex", folder / "arduino"
    flags = ["-std=gnu11", "-O2"]
    source = str(AVR / "avr_host.c")
    subprocess.run(["gcc", *flags, source, "-lsimavr", "-lelf", "-o", str(host)], check=True)
    os.environ["AVR_HOST"] = str(host)
    blank.write_text(BLANK)
    with patience(), Arduino(host, KIND, WIRINGS[KIND], port, blank) as arduino:
        step("board", "flash", "--board", KIND, "--port", port)
        step("board", "configure", folder / "board.yaml", "--port", port)
        step("board", "show", "--port", port)
    eeprom = folder / "eeprom.bin"
    eeprom.write_bytes(arduino.eeprom)
    return eeprom


def control(folder: Path, settings: Settings, board: Path) -> bool:
    """Let the daemon control the box for an hour, and say how it did."""
    print(f"\n$ greenhouse run, {CONTROL_MIN:g} min of the board's time", flush=True)
    with Lab(settings, board=board, folder=folder, with_truth=True) as lab:
        lab.run(minutes=CONTROL_MIN)
        columns = lab.columns()
    by = Counter(tick.decision.controller for tick in lab.history)
    half = len(lab.history) // 2
    error = columns["temp_air_c"] - columns["reference_c"]
    print(f"decided by: {', '.join(f'{name} {count}' for name, count in by.items())}")
    print(
        f"air {columns['temp_air_c'][0]:.1f} °C at first, {columns['temp_air_c'][-1]:.1f} °C at last; ",
        end="",
    )
    print(f"MAE of the second half {np.nanmean(np.abs(error[half:])):.2f} K", flush=True)
    return set(by) == {commission.CONTROLLER}


def main(words: Sequence[str] | None = None) -> int:
    """0 when the box is controlled by its own twin in the end."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--core", choices=("avr", "python"), default="avr", help="default: avr, a Mega in simavr"
    )
    parser.add_argument("--minutes", type=float, default=60.0, help="of step tests; default: %(default)g")
    given = parser.parse_args(words)
    print("\n".join(header()))
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="walk-") as temporary:
        short = ShortPaths(sys.stdout, Path(temporary))
        try:
            with redirect_stdout(short), redirect_stderr(short):
                is_there = walk(Path(temporary), given.core, given.minutes)
        except StepFailure as failure:
            print(f"ended: {failure}")
            return 1
    print(f"the whole way took {(time.monotonic() - begun) / 60.0:.0f} min of this machine's time")
    return 0 if is_there else 1


if __name__ == "__main__":
    sys.exit(main())
