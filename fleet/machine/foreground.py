"""Runs the programs of a fleet below this process, until it is asked to end or one of them ends."""

import fcntl
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edge.core.errors import RequestError
from edge.core.processes import die_with_parent, end_process
from fleet.machine.engines import Engine
from fleet.machine.places import LOCAL, FleetMachine, FleetPlaces, is_free

READY_MAX_S = 90.0  # a loaded machine needs some seconds for each
END_MAX_S = 30.0  # VictoriaMetrics writes to the disk what it has in memory
LOOK_S = 0.1


def run_below(
    places: FleetPlaces, machine: FleetMachine, programs: Iterable[Engine], tell: Callable[[str], None]
) -> int:
    """Start them and wait; return 0 for an end that was asked for, 1 where a program has ended by itself.

    Errors : RequestError for a port that is taken, or a program that does not start
    """
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    with _lock(places), ExitStack() as stack:
        running: list[tuple[Engine, subprocess.Popen[bytes]]] = []
        for engine in programs:
            if engine.port and not is_free(engine.port):
                raise RequestError(f"port {engine.port} of {engine.name} is taken: see {places.machine}")
            process = _start(engine, _log(machine, engine))
            stack.callback(end_process, process, END_MAX_S)
            running.append((engine, process))
            _wait_until_ready(engine, process, _log(machine, engine), asked)
        tell("all engines run")
        while not asked.wait(LOOK_S):
            for engine, process in running:
                if process.poll() is not None:
                    tell(f"{engine.name} has ended with {process.returncode}: see {_log(machine, engine)}")
                    return 1
    return 0


def end_foreground(places: FleetPlaces) -> bool:
    """End the `up --foreground` of a folder and wait for it; return whether one ran. Errors: RequestError"""
    with _lock_file(places) as file:
        if _take(file):
            return False
        holder = int(os.pread(file, 20, 0) or 0)
        if holder:
            os.kill(holder, signal.SIGTERM)
        until_s = time.monotonic() + 2 * END_MAX_S
        while not _take(file):
            if time.monotonic() > until_s:
                raise RequestError(f"process {holder} does not end: see {places.lock}")
            time.sleep(LOOK_S)
        return True


@contextmanager
def _lock(places: FleetPlaces) -> Iterator[None]:
    """Hold the folder, so that two of these never share a store. Errors: RequestError"""
    with _lock_file(places) as file:
        if not _take(file):
            raise RequestError(f"{places.folder}: another `greenhouse fleet up` runs here")
        os.ftruncate(file, 0)
        os.pwrite(file, str(os.getpid()).encode(), 0)
        yield
        os.ftruncate(file, 0)


@contextmanager
def _lock_file(places: FleetPlaces) -> Iterator[int]:
    file = os.open(places.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        yield file
    finally:
        os.close(file)


def _take(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _log(machine: FleetMachine, engine: Engine) -> Path:
    return Path(machine.data) / "log" / f"{engine.name}.log"


def _start(engine: Engine, log: Path) -> "subprocess.Popen[bytes]":
    with log.open("ab") as file:
        return subprocess.Popen(
            engine.command,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            env={**os.environ, **engine.environment},
            start_new_session=True,  # Ctrl-C is for this process, which ends them in order
            preexec_fn=die_with_parent,
        )


def _wait_until_ready(
    engine: Engine, process: "subprocess.Popen[bytes]", log: Path, asked: threading.Event
) -> None:
    until_s = time.monotonic() + READY_MAX_S
    while engine.port and not asked.is_set() and not _listens(engine.port):
        if process.poll() is not None:
            said = log.read_text(errors="replace").strip().splitlines()[-3:]
            raise RequestError(
                f"{engine.name} has ended with {process.returncode}: {log}: {' / '.join(said)}"
            )
        if time.monotonic() > until_s:
            raise RequestError(
                f"{engine.name} does not listen at {engine.port} after {READY_MAX_S:g} s: see {log}"
            )
        time.sleep(LOOK_S)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOCAL, port)) == 0
