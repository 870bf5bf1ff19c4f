"""A rig in simulated time: the whole daemon in lock-step with a virtual board.

    with Lab(settings, seed=3) as lab:
        lab.run(minutes=30)
        lab.history  # the records of all ticks

Training, comparisons, benchmarks and tests run a rig in simulated time by this class alone. A daemon in real
time is a process of its own: `tests/support/daemon_process.py`.
"""

import math
import select
import sqlite3
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray

from edge.app.daemon import Daemon
from edge.board.serial_port import SerialPort
from edge.board.sim_clock import SLICE_S, START_UTC, SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.config.settings import Settings
from edge.core.clock import Clock, Port
from edge.core.messages import ReadingQuality, TickRecord
from firmware_protocol.messages import ResetCause
from firmware_protocol.virtual_board.board_config import RIG_PARTS, BoardConfig
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.core import BoardCore
from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.lockstep import milliseconds
from firmware_protocol.virtual_board.plant import Plant
from firmware_protocol.virtual_board.store import Eeprom

WRITTEN_S = 10.0  # real time; the disk of a busy machine takes seconds
NO_DESCRIPTOR = -1
Document = Mapping[str, Any]  # of a YAML file


class InProcessBoard:
    """The device's time and line: a `Clock` of edge/core that opens a `WirePort` of edge/board.

    A run over a pseudo-terminal gives the same columns (tests/training/test_lab.py) and takes longer.
    """

    def __init__(self, seed: int, chamber: Path | None = None, plant: Plant | None = None) -> None:
        plant = plant or Plant(Chamber(*load(chamber), seed), RIG_PARTS)
        self.device = Device(_boot, plant, Eeprom(None), [])
        self.bytes_in = self.bytes_out = 0
        self._arrived = bytearray()
        self._now_s = self.device.now_ms / 1000

    def now(self) -> float:
        """Return the simulated time since the board's start [s]."""
        return self._now_s

    def utc(self) -> float:
        """As `edge.board.sim_clock.SimClock`'s."""
        return START_UTC + self._now_s

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Let the board advance to `until_s`, or until it has sent something or `wake` is readable."""
        while not (self._now_s >= until_s or (port is not None and self._arrived) or _readable(wake)):
            self._advance(min(until_s, self._now_s + SLICE_S), stop_on_bytes=port is not None)

    def truth(self) -> Mapping[str, Any]:
        """Return the true state of the chamber, as the board's process answers it."""
        return {"chamber": self.device.plant.truth(self.device.now_ms)}

    def _advance(self, to_s: float, stop_on_bytes: bool) -> None:
        # As lock-step does it: asked in whole milliseconds, told in the host's own number.
        asked_ms = milliseconds(math.ceil(to_s * 1000 - 1e-3) / 1000)
        device = self.device
        while device.now_ms < asked_ms:
            device.step(asked_ms)
            data = device.transmit()
            self._arrived += data
            if data and stop_on_bytes:
                break
        self._now_s = max(device.now_ms / 1000, to_s if device.now_ms >= asked_ms else self._now_s)

    def open(self, path: str, baudrate: int) -> "InProcessBoard":
        """Return the port: there is only one."""
        return self

    def fileno(self) -> int:
        """Nothing that the kernel knows."""
        return NO_DESCRIPTOR

    def read(self) -> bytes:
        """All bytes that have arrived, maybe none."""
        data = bytes(self._arrived)
        self._arrived.clear()
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Write bytes, which the board receives now."""
        self.bytes_out += len(data)
        self.device.receive(data)

    def close(self) -> None:
        """Close the port; the board goes on by itself."""


class Lab:
    """A virtual board, its clock, and the daemon that `run` starts on it.

    board : "process", behind a pseudo-terminal as on a rig; "here", in this process, faster and without
        faults or options; or the control socket of a board that runs already
    seed : of the board
    folder : place of all files, where `settings` point already; without it a temporary folder is made
    chamber : what differs in the simulated box; plant : another box, "here" alone
    faults : the board's script; options : of its command line
    speed : simulated seconds per real second; None: as fast as the machine goes
    clock : makes the daemon's clock from the board's, e.g. one that watches the pins
    recorded : each tick is in the history before the next begins, for controllers that read it
    answer_s : after each tick a language model has so long for an answer that was late, as on a rig
    with_truth : keep the chamber's true state at each tick in `truths`
    on_start, on_tick : called with the daemon wired, and after each tick
    daemon : further fields of `Daemon`, e.g. `reference`, `more_controllers`
    """

    def __init__(
        self,
        settings: Settings,
        *,
        board: Literal["process", "here"] | Path = "process",
        seed: int = 1,
        folder: Path | None = None,
        chamber: Document | None = None,
        plant: Plant | None = None,
        faults: Sequence[Document] = (),
        options: Sequence[str] = (),
        speed: float | None = None,
        clock: Callable[[Any], Clock] = lambda board: board,
        recorded: bool = False,
        answer_s: float = 0.0,
        with_truth: bool = False,
        on_start: Callable[[], None] = lambda: None,
        on_tick: Callable[[TickRecord], None] = lambda record: None,
        **daemon: Any,
    ) -> None:
        self.settings = settings
        self.history: list[TickRecord] = []
        self.truths: list[Mapping[str, float]] = []
        self._board, self._seed, self._folder, self._speed = board, seed, folder, speed
        self.folder = Path() if folder is None else folder
        self._chamber, self._faults, self._options = chamber, faults, options
        self._plant = plant
        self._make_clock, self._recorded, self._with_truth = clock, recorded, with_truth
        self._answer_s = answer_s
        self._on_start, self._on_tick, self._more = on_start, on_tick, daemon
        # So many ticks the history holds then.
        self._last_tick: float = math.inf
        self._is_stopped = False

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            if self._folder is None:
                self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lab-")))
                self.settings = settings_in(self.folder, self.settings)
            self.board = self._open_board(stack)
            self.clock = self._make_clock(self.board)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def run(self, minutes: float = math.inf, *, ticks: float = math.inf, until_s: float = math.inf) -> None:
        """Start the daemon and end it after so much time or so many ticks, whichever comes first.

        Without a limit the daemon runs until `stop` or a signal, and no history is kept: it would fill the
        memory. A second call starts the daemon again on the same board and files.
        Errors : KeyboardInterrupt where a signal has ended the daemon before its limit
        """
        end_s = min(self.board.now() + 60.0 * minutes, until_s)
        self._last_tick = len(self.history) + ticks
        self._is_limited = math.isfinite(min(end_s, ticks))
        self._is_stopped = False
        port = self.board.open if isinstance(self.board, InProcessBoard) else SerialPort
        self._daemon = Daemon(
            self.settings, self.clock, self._after_tick, stop_at_s=end_s, open_port=port, **self._more
        )
        with self._daemon:
            self._on_start()
            self._daemon.run()
        if self._is_limited and not self._is_stopped and self.board.now() < end_s:
            raise KeyboardInterrupt  # the daemon took the signal for itself

    def stop(self) -> None:
        """End the daemon after the tick that runs; from any thread."""
        self._is_stopped = True
        self._daemon.stop()

    @property
    def counted(self) -> Mapping[str, int]:
        """The counts of the last run's language model, empty without one."""
        model = self._daemon.language_model
        return {} if model is None else dict(model.counted)

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Return the history with its truths as columns with a row per tick;
        NaN for a measurement that is not good.

        time_s, temp_air_c (measured), true_air_c, sensor_air_c (without noise, steps and bias),
        temp_ambient_c, reference_c, heater_duty, fan_on (as the board confirmed them), solve_ms
        """
        rows = [_row(record, truth) for record, truth in zip(self.history, self.truths, strict=True)]
        return {key: np.array([row[key] for row in rows]) for key in rows[0]}

    def _open_board(self, stack: ExitStack) -> "SimClock | InProcessBoard":
        chamber = self._write("chamber.yaml", self._chamber)
        if self._board == "here":
            return InProcessBoard(self._seed, chamber, self._plant)
        if isinstance(self._board, Path):
            return stack.enter_context(closing(SimClock(self._board, self._speed)))
        script = self._write("faults.yaml", [dict(fault) for fault in self._faults])
        files = {"--chamber": chamber, "--faults": script}
        options = [word for name, path in files.items() if path for word in (name, str(path))]
        rig = stack.enter_context(virtual_rig(self.folder, self._seed, [*options, *self._options]))
        return stack.enter_context(closing(SimClock(rig.control, self._speed)))

    def _write(self, name: str, document: Any) -> Path | None:
        if not document:
            return None
        path = self.folder / name
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        return path

    def _after_tick(self, record: TickRecord) -> None:
        if self._recorded:
            _wait_recorded(Path(self.settings.history.path), record.seq)
        if self._answer_s and self._daemon.language_model is not None:
            self._daemon.language_model.wait(self._answer_s)
        if self._is_limited:
            self.history.append(record)
        if self._with_truth:
            self.truths.append(self.board.truth()["chamber"])
        self._on_tick(record)
        if len(self.history) >= self._last_tick:
            self.stop()


def _row(record: TickRecord, truth: Mapping[str, float]) -> dict[str, float]:
    air, echo = record.readings["temp_air"], record.echo
    return {
        "time_s": record.time_s,
        "temp_air_c": air.value if air.quality is ReadingQuality.GOOD and air.value is not None else np.nan,
        "true_air_c": truth["temp_air_c"],
        "sensor_air_c": truth["temp_sensor_c"],
        "temp_ambient_c": record.estimate.temp_ambient,
        "reference_c": record.reference_c,
        "heater_duty": echo.heater_duty if echo is not None else 0.0,
        "fan_on": echo.fan if echo is not None else 0.0,
        "solve_ms": float(record.decision.why.get("solve_ms", record.decide_ms)),
    }


def _wait_recorded(history: Path, seq: int) -> None:
    """Until the tick `seq` is in the history, at most WRITTEN_S.

    On a rig a minute lies between a tick and the next question. In lock-step it is some milliseconds, and
    what a model reads would depend on how fast the disk is: two runs with one seed would differ.
    """
    give_up = time.monotonic() + WRITTEN_S
    with closing(sqlite3.connect(history)) as reader:
        while not reader.execute("SELECT 1 FROM ticks WHERE seq = ?", (seq,)).fetchone():
            if time.monotonic() > give_up:
                return
            time.sleep(0.001)


def _boot(persistent: bytes, cause: ResetCause, boot_count: int) -> BoardCore:
    return BoardCore(BoardConfig(), persistent, cause, boot_count)


def _readable(descriptor: int | None) -> bool:
    return descriptor is not None and bool(select.select([descriptor], [], [], 0)[0])
