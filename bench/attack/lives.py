"""The daemon lives and dies against one virtual board; the truth about the box is recorded all the time."""

import json
import os
import resource
import signal
import sqlite3
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.attack.plan import AttackPlan, Life
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.messages import TickRecord
from tests.support.virtual_board import CORES
from tests.support.watched_clock import Look, TimedRequest, WatchedClock, look_at
from training.lab import Lab

LOOK_S = 0.5
GIVE_UP_S = 300.0  # real time for one life: beyond, the daemon hangs


@dataclass(frozen=True, slots=True)
class AnsweredOrder:
    """An order that was answered, and when it was given."""

    time_s: float
    request: Mapping[str, Any]
    reply: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class LifeRemains:
    """The remains of one life of the daemon: numbers of its ticks, and how its process ended."""

    life: Life
    begin_s: float
    end_s: float
    seqs: tuple[int, ...]
    stored: tuple[int, ...]  # numbers in the history afterwards
    gaps: tuple[tuple[int, int], ...]
    exit_code: int  # negative: the signal
    output: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that is known of one scenario."""

    plan: AttackPlan
    looks: tuple[Look, ...]
    orders: tuple[AnsweredOrder, ...]
    lives: tuple[LifeRemains, ...]


def run(plan: AttackPlan, folder: Path) -> Outcome:
    """Every life of the plan, one after the other, in `folder`."""
    script, box = folder / "faults.yaml", folder / "chamber.yaml"
    script.write_text(yaml.safe_dump([dict(fault) for fault in plan.faults]))
    box.write_text(yaml.safe_dump(dict(plan.chamber)))
    options = ("--core", CORES[plan.core], "--faults", str(script), "--chamber", str(box))
    settings = settings_in(folder, config.parse(yaml.safe_dump(dict(plan.settings)), "attack"))
    looks: list[Look] = []
    given: list[AnsweredOrder] = []
    lives: list[LifeRemains] = []
    begin_s = 0.0
    with virtual_rig(folder, plan.seed, options) as rig:
        for life in plan.lives:
            notes = folder / f"life-{len(lives)}.jsonl"
            code = _live(life, begin_s, plan, settings, rig.control, notes)
            lived = _read(life, begin_s, notes, settings, code, looks, given)
            lives.append(lived)
            begin_s = _stay_dead(rig.control, life.dead_s, looks)
    return Outcome(plan, tuple(looks), tuple(given), tuple(lives))


def _live(
    life: Life, begin_s: float, plan: AttackPlan, settings: Settings, control: Path, notes: Path
) -> int:
    """One life in a process of its own; its exit code."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _be_the_daemon(life, begin_s, plan, settings, control, notes)
    deadline = time.monotonic() + GIVE_UP_S
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGABRT)
    os.waitpid(child, 0)
    return -signal.SIGABRT


def _be_the_daemon(
    life: Life, begin_s: float, plan: AttackPlan, settings: Settings, control: Path, notes: Path
) -> None:
    """In the child; does not return."""
    code = 1
    try:
        out = os.open(notes.with_suffix(".log"), os.O_CREAT | os.O_WRONLY | os.O_APPEND)
        os.dup2(out, 1)
        os.dup2(out, 2)
        with notes.open("a", buffering=1) as file:
            _daemon(life, begin_s, plan, settings, control, _Notes(file.fileno(), life, begin_s, plan.seed))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _daemon(
    life: Life, begin_s: float, plan: AttackPlan, settings: Settings, control: Path, notes: "_Notes"
) -> None:
    end_s = begin_s + life.length_s
    orders = [order for order in plan.orders if begin_s <= order.at_s < end_s]

    def watch(board: SimClock) -> WatchedClock:
        return WatchedClock(
            board, Path(settings.control_socket.path), orders, LOOK_S, notes.look, notes.reply
        )

    with Lab(
        settings,
        board=control,
        folder=control.parent,
        clock=watch,
        on_start=lambda: None if life.file_max is None else _fill_the_disk(life.file_max),
        on_tick=notes.tick,
    ) as lab:
        lab.run(until_s=end_s)


def _fill_the_disk(file_max: int) -> None:
    """Limit file sizes, so that writing beyond fails with EFBIG, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_max, hard))


class _Notes:
    """Writes each fact through a pipe to a process of its own, so that a kill or a full disk loses none."""

    def __init__(self, descriptor: int, life: Life, begin_s: float, seed: int) -> None:
        self._pipe = _writer_of(descriptor)
        self._rng = np.random.default_rng([seed, int(begin_s)])
        # A life that is killed ends a little before its time, at any moment of the real time there.
        share = self._rng.uniform(0.02, 0.98)
        self._kill_s = begin_s + share * life.length_s if life.killed else float("inf")

    def look(self, look: Look) -> None:
        self._write(
            "look",
            [
                look.time_s,
                look.temp_air_c,
                look.heater_pin,
                look.heat,
                look.fan,
                look.cutoff_open,
                look.pins_on,
            ],
        )
        if look.time_s >= self._kill_s:
            self._kill_s = float("inf")
            threading.Timer(
                float(self._rng.uniform(0.0, 0.01)), os.kill, (os.getpid(), signal.SIGKILL)
            ).start()

    def reply(self, given_s: float, order: TimedRequest, reply: Mapping[str, Any]) -> None:
        kept = {key: reply[key] for key in ("ok", "error", "warning") if key in reply}
        self._write("given", [given_s, order.request, kept])

    def tick(self, record: TickRecord) -> None:
        self._write("tick", [record.seq])

    def _write(self, kind: str, values: list[Any]) -> None:
        os.write(self._pipe, json.dumps([kind, values]).encode() + b"\n")


def _writer_of(descriptor: int) -> int:
    """Return the writing end of a pipe whose other end a grandchild copies to the file."""
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.close(writing)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while data := os.read(reading, 65536):
            os.write(descriptor, data)
        os._exit(0)
    os.close(reading)
    return writing


def _read(
    life: Life,
    begin_s: float,
    notes: Path,
    settings: Settings,
    code: int,
    looks: list[Look],
    given: list[AnsweredOrder],
) -> LifeRemains:
    seqs: list[int] = []
    end_s = begin_s
    for kind, values in _lines(notes):
        if kind == "tick":
            seqs.append(values[0])
        elif kind == "given":
            given.append(AnsweredOrder(*values))
        else:
            time_s, air, pin, heat, fan, cutoff, on = values
            end_s = time_s
            looks.append(Look(time_s, air, pin, None, heat, fan, cutoff, 0.0, tuple(on)))
    stored, gaps = _history(Path(settings.history.path))
    log = notes.with_suffix(".log").read_text(errors="replace")
    return LifeRemains(life, begin_s, end_s, tuple(seqs), stored, gaps, code, log)


def _lines(notes: Path) -> list[tuple[str, list[Any]]]:
    """All notes; the helper that writes them may need a moment after the daemon's end."""
    deadline = time.monotonic() + 2.0
    text = notes.read_text()
    while time.monotonic() < deadline:
        time.sleep(0.02)
        again = notes.read_text()
        if again == text and text.endswith("\n"):
            break
        text = again
    return [(kind, values) for kind, values in map(json.loads, text.splitlines())]


def _history(path: Path) -> tuple[tuple[int, ...], tuple[tuple[int, int], ...]]:
    """Numbers of the ticks and gaps in the history as a reader sees it."""
    if not path.exists():
        return (), ()
    with closing(sqlite3.connect(f"file:{path}?mode=rw", uri=True, timeout=10.0)) as connection:
        try:
            seqs = connection.execute("SELECT seq FROM ticks ORDER BY seq").fetchall()
            gaps = connection.execute("SELECT first_seq, last_seq FROM gaps ORDER BY first_seq").fetchall()
        except sqlite3.OperationalError:  # killed before the tables were made
            return (), ()
    return tuple(seq for (seq,) in seqs), tuple(gaps)


def _stay_dead(control: Path, dead_s: float, looks: list[Look]) -> float:
    """Let the board go on alone, looking; the time afterwards."""
    with closing(SimClock(control)) as sim:
        until_s = sim.now() + dead_s
        while sim.now() < until_s:
            sim.wait(None, None, min(until_s, sim.now() + LOOK_S))
            looks.append(look_at(sim.truth()))
        return sim.now()
