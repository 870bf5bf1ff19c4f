"""Hostile input files: python -m bench.attack.files --seed S --count N.

Each case damages one file that a command of `greenhouse` takes: settings, runs, profiles, twins, ARX models,
bundles. The command runs in a process of its own, with limits on memory and time. It refuses the file in a
few lines that name it, or succeeds where the damage left the file valid; nothing ends in a traceback.
"""

import contextlib
import io
import json
import os
import re
import resource
import signal
import sqlite3
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bench.attack.part import TrialResult, evil_document, evil_raw, evil_text, main_of
from edge import __main__ as greenhouse
from edge.bundle.archive import pack
from edge.bundle.store import PACKAGED_FOLDER
from edge.config.example import document
from edge.config.settings import Settings
from edge.models.arx_file import DEFAULT_PATH

MEMORY = 1536 << 20  # address space that a command may add [bytes]
TIME_S = 10  # of a command's CPU; its wall time may be WALL times as long on a busy machine
WALL = 4
MESSAGE_MAX = 2000  # characters on standard error
LINES_MAX = 8
ROWS = 60  # of the honest run, a minute each
TWIN = b"""geometry: {heater_max_w: 100}
effects:
  wall_loss: {UA: {value: 2.5, low: 2.2, high: 2.8}}
sensor: {noise_sd_k: 0.05}
"""
CELLS = (
    "1e308", "-1e308", "1e-300", "nan", "inf", "9" * 400, "9" * 200_000, "", "-0", "1_0", "\u0663", "0x10",
    '"', "x" * 9000, "1e12", "-1e12", "2", "true",
)  # fmt: skip
SCALARS = (
    "9" * 400, "9" * 5000, "1e999", ".nan", "-.inf", "[" * 5000, "{a: " * 5000, "&a [*a]", "*a", "!!int x",
    "!!timestamp x", "!!float x", "!!bool x", "!!python/object/apply:os.system [id]", '"\\0"', '"\\ud800"',
    "0o17", "08", "x" * 100_000, "[]", "{}", "~", "-1", "1e-300", "1e300", "2001-01-01", "? [a]", "|\n x",
    "%", "'",
)  # fmt: skip
FACTS = ("start_utc", "record_from_s", "role", "fan_on", "x" * 5000)
NAMES = ("time_s", "x" * 200_000, "", "\x1b[2J", "fan")
BOMBED = ("control: *a11\n", "effects: *a11\n", "*a11: 1\n", "geometry: {x: *a11}\n")
LINES = ("? [a, b]\n: 1", "x" * 9000 + ": 1", "\t")
HUGE = 10_000_000  # characters of a scalar
BOMB = b"".join(
    b"a%d: &a%d [%s]\n" % (level, level, b", ".join([b"*a%d" % (level - 1)] * 9) if level else b"1")
    for level in range(12)
)


PROFILE = b"# record_from_s: 60\ntime_s,heater_duty,fan_on\n0,0.5,0\n600,1,1\n1200,0,0\n"
SQL_VALUES = (
    "NULL", "'x'", "''", "-1", "9223372036854775807", "1e308", "9e999", "-9e999", "zeroblob(100)", "X'ff00'",
    "'{}'", "'[]'", "'[null]'", "'[' || hex(zeroblob(90000)) || ']'",
    "replace(hex(zeroblob(50000)), '0', '[')",
    "hex(zeroblob(5000000))", "char(27) || '[2J'", "CAST(X'eda080' AS TEXT)", "'2'", "'1e999'",
)  # fmt: skip


def honest_run() -> bytes:
    """Return a run of an hour that every command accepts."""
    rows = ["time_s,temp_air_c,temp_ambient_c,heater_duty,fan_on"]
    for row in range(ROWS):
        duty = 0.1 * ((row // 7) % 5)
        rows.append(f"{60 * row},{22 + 3 * np.sin(row / 9) + duty:.3f},21.5,{duty:.1f},{(row // 20) % 2}")
    return "\n".join(["# start_utc: 2026-07-01T12:00:00Z", *rows, ""]).encode()


@dataclass(frozen=True, slots=True)
class InputKind:
    """A kind of input: its honest content, what damages it, and the commands that read it.

    In a command FILE is the damaged file, FOLDER a folder of its own with the honest ones.
    """

    name: str
    content: Callable[[], bytes]
    damage: Callable[[np.random.Generator, bytes], bytes]
    commands: tuple[str, ...]


def _csv(rng: np.random.Generator, content: bytes) -> bytes:
    lines = content.decode().splitlines()
    kind = int(rng.integers(7))
    row = int(rng.integers(len(lines)))
    if kind <= 2:
        cells = lines[row].split(",")
        cells[int(rng.integers(len(cells)))] = _one(rng, CELLS)
        lines[row] = ",".join(cells)
    elif kind == 3:
        lines.insert(0, f"# {_one(rng, FACTS)}: {evil_text(rng)}")
    elif kind == 4:
        lines[row] = _one(rng, (",".join("abc" for _ in range(9000)), lines[row] * 2, "#", "x" * HUGE))
    elif kind == 5:
        lines = lines[:2]
    else:
        header = next(at for at, line in enumerate(lines) if not line.startswith("#"))
        lines[header] = f"{lines[header].rpartition(',')[0]},{_one(rng, NAMES)}"
    return "\n".join(lines).encode(errors="surrogatepass")


def _yaml(rng: np.random.Generator, content: bytes) -> bytes:
    lines = content.decode().splitlines()
    kind = int(rng.integers(6))
    row = int(rng.integers(len(lines)))
    if kind <= 2:
        row = int(rng.choice([at for at, line in enumerate(lines) if re.search(r": \S", line)]))
        lines[row] = f"{lines[row].partition(':')[0]}: {_one(rng, SCALARS)}"
    elif kind == 3:
        return BOMB + _one(rng, BOMBED).encode()
    elif kind == 4:
        lines.insert(
            row, _one(rng, ("? [a, b]\n: 1", "x" * 9000 + ": 1", f"a: {'x' * HUGE}", lines[row], "\t"))
        )
    else:
        return (b"a: 1\n" * 20_000, b"- [" * 3000)[int(rng.integers(2))]
    return "\n".join(lines).encode(errors="surrogatepass")


def _one(rng: np.random.Generator, options: Sequence[str]) -> str:
    return options[int(rng.integers(len(options)))]


def _json(rng: np.random.Generator, content: bytes) -> bytes:
    return evil_document(rng, json.loads(content))


def _zip(rng: np.random.Generator, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 40))):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed[: int(rng.integers(len(changed)))]) if rng.random() < 0.3 else bytes(changed)


def _bundle() -> bytes:
    return pack(PACKAGED_FOLDER)


@cache
def _history() -> bytes:
    """Return a database with two hours: one that a virtual rig recorded, one that was imported."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "history.db"
        (Path(folder) / "first.csv").write_bytes(honest_run())
        (Path(folder) / "profile.csv").write_bytes(PROFILE)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            words = f"experiment {folder}/profile.csv --virtual --out {folder}/out.csv --history {path}"
            assert greenhouse.main(words.split()) == 0
            assert greenhouse.main(["import", f"{folder}/first.csv", "--history", str(path)]) == 0
        return path.read_bytes()


def _database(rng: np.random.Generator, content: bytes) -> bytes:
    if rng.random() < 0.3:
        return _zip(rng, content)
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(sqlite3.Error):
        path = Path(folder) / "history.db"
        path.write_bytes(content)
        with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as connection:
            _harm(rng, connection)
        return path.read_bytes()
    return content


def _harm(rng: np.random.Generator, connection: sqlite3.Connection) -> None:
    """Damage the database as a writer or a failing disk could."""
    query = "SELECT name FROM sqlite_schema WHERE type = 'table' AND sql IS NOT NULL ORDER BY name"
    table = _one(rng, [name for (name,) in connection.execute(query)])
    columns = [row[1] for row in connection.execute(f'PRAGMA table_info("{table}")')]
    kind = int(rng.integers(8))
    if kind <= 3:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute("PRAGMA foreign_keys = OFF")
        column, value = _one(rng, columns), _one(rng, SQL_VALUES)
        some = "" if rng.random() < 0.5 else f'WHERE "{columns[0]}" % 7 = 3'
        connection.execute(f'UPDATE OR IGNORE "{table}" SET "{column}" = {value} {some}')
    elif kind == 4:
        connection.execute(f"PRAGMA user_version = {_one(rng, ('-1', '0', '1', '4', '99', '2147483647'))}")
    elif kind == 5:
        connection.execute(f'DELETE FROM "{table}"')
    else:
        connection.execute("PRAGMA legacy_alter_table = ON")  # its views may stay without it
        connection.execute(f'ALTER TABLE "{table}" RENAME TO hidden')
        if kind == 7:
            connection.execute(
                f'CREATE VIEW "{table}" AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)'
                " SELECT hidden.*, n.x FROM hidden, n"
            )


VERIFY, INSTALL = "bundle --config FOLDER/rig.yaml verify", "bundle --config FOLDER/rig.yaml install"
KINDS = (
    InputKind(
        "settings",
        lambda: document(Settings()).encode(),
        _yaml,
        (
            "check-config FILE",
            "bundle --config FILE list",
        ),
    ),
    InputKind(
        "run",
        honest_run,
        _csv,
        (
            "import FILE --history FOLDER/history.db",
            "plot FILE --out FOLDER/run.svg",
            "fit-arx --train FILE --validate FOLDER/run.csv --out FOLDER/new.json",
            "replay FILE --controller rules",
            "twin simulate FILE --twin FOLDER/twin.yaml",
            "twin diagnose FILE --twin FOLDER/fit.yaml --out FOLDER/report --json-only",
        ),
    ),
    InputKind(
        "reference",
        lambda: b"# record_from_s: 60\ntime_s,reference_c\n0,24\n600,26\n1200,22\n",
        _csv,
        ("check-config FOLDER/csv.yaml",),
    ),
    InputKind(
        "profile",
        lambda: PROFILE,
        _csv,
        ("experiment FILE --out FILE/none",),
    ),
    InputKind(
        "twin",
        lambda: TWIN,
        _yaml,
        (
            "twin simulate FOLDER/run.csv --twin FILE",
            "twin diagnose FOLDER/run.csv --twin FILE --out FOLDER/report --json-only",
            "replay FOLDER/run.csv --twin FILE --controller rules",
            "twin adopt FILE --to FOLDER/adopted.yaml",
        ),
    ),
    InputKind(
        "report",
        lambda: b'{"effects": ["wall_loss"], "twin_after": "twin.yaml"}',
        _json,
        ("twin adopt FOLDER --to FOLDER/adopted.yaml",),
    ),
    InputKind(
        "arx",
        DEFAULT_PATH.read_bytes,
        _json,
        ("replay FOLDER/run.csv --model FILE --controller rules", "check-config FOLDER/model.yaml"),
    ),
    InputKind(
        "history",
        _history,
        _database,
        (
            "why --history FILE",
            "plot --history FILE --out FOLDER/run.svg",
            "import FOLDER/run.csv --history FILE",
            "twin diagnose --history FILE --twin FOLDER/fit.yaml --out FOLDER/report --json-only",
        ),
    ),
    InputKind("bundle", _bundle, _zip, (f"{VERIFY} FILE", f"{INSTALL} FILE")),
    InputKind(
        "key",
        (PACKAGED_FOLDER.parent / "default_bundle.pub").read_bytes,
        _zip,
        (f"{VERIFY} FOLDER/bundle.zip --keys FOLDER/keys",),
    ),
)
# Where the damaged file of a kind must lie.
PLACES = {
    "reference": "reference.csv",
    "report": "diagnosis.json",
    "key": "keys/rig.pub",
    "arx": "hostile.arx",
}


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """Run a case of each seed: one damaged file, one command."""
    bundle = _bundle()
    for number in range(seed, seed + count):
        rng = np.random.default_rng(number)
        kind = KINDS[int(rng.integers(len(KINDS)))]
        with tempfile.TemporaryDirectory(prefix="gh-file-") as temporary:
            folder = Path(temporary)
            _honest(folder, bundle)
            path = folder / PLACES.get(kind.name, f"hostile.{'csv' if kind.damage is _csv else kind.name}")
            what = _place(rng, path, kind)
            words = (
                str(rng.choice(kind.commands))
                .replace("FILE", str(path))
                .replace("FOLDER", str(folder))
                .split()
            )
            yield TrialResult(
                f"seed {number}, {what} as {kind.name}: {' '.join(words)}",
                1,
                _violations(words, folder, path),
            )


def _honest(folder: Path, bundle: bytes) -> None:
    (folder / "keys").mkdir()
    for name, content in {
        "run.csv": honest_run(),
        "twin.yaml": TWIN,
        "fit.yaml": b"effects: {wall_loss: {UA: {fit: true, start: 2.5}}}\n",
        "csv.yaml": f"reference: {{kind: csv, csv: {folder}/reference.csv}}\n".encode(),
        "model.yaml": f"control: {{model: {folder}/hostile.arx}}\n".encode(),
        "rig.yaml": f"bundle: {{path: {folder}/store, trusted_keys: {folder}/keys}}\n".encode(),
        "bundle.zip": bundle,
    }.items():
        (folder / name).write_bytes(content)


def _place(rng: np.random.Generator, path: Path, kind: InputKind) -> str:
    """Put something hostile at `path`; returns in a word what."""
    special = int(rng.integers(20))
    if special == 0:
        os.mkfifo(path)
        return "a FIFO"
    if special == 1:
        path.symlink_to("/dev/zero")
        return "/dev/zero"
    if special == 2:
        path.mkdir()
        return "a folder"
    if special == 3:
        path.symlink_to(path)
        return "a link to itself"
    if special == 4:
        path.write_bytes(b"")
        os.truncate(path, 5 << 30)
        return "5 GB of zeros"
    if special == 5:
        path.write_bytes(evil_raw(rng))
        return "any bytes"
    path.write_bytes(kind.damage(rng, kind.content()))
    return "a damaged file"


def _violations(words: list[str], folder: Path, path: Path) -> list[str]:
    begun_s = time.monotonic()
    errors = folder / "errors.txt"
    child = os.fork()
    if child == 0:
        _command(words, folder, errors)
    _, status = os.waitpid(child, 0)
    code, text = os.waitstatus_to_exitcode(status), errors.read_text(errors="replace")
    found = []
    if code < 0:
        found.append(f"ended by signal {-code} after {time.monotonic() - begun_s:.0f} s")
    elif "Traceback" in text:
        found.append(f"a traceback: {text.strip().splitlines()[-1][:200]}")
    elif len(text) > MESSAGE_MAX or (code and len(text.splitlines()) > LINES_MAX):
        found.append(f"a message of {len(text)} characters: {text[:200]!r}")
    elif code and not any(name in text for name in (path.name, "csv.yaml", "model.yaml")):
        found.append(f"exit code {code}, and the message does not name the file: {text[:200]!r}")
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f]", text):
        found.append("control characters in the message")
    return found


def _command(words: list[str], folder: Path, errors: Path) -> None:
    """Run the command in this process, the child, and end it."""
    code = 70
    try:
        signal.alarm(WALL * TIME_S)
        resource.setrlimit(resource.RLIMIT_CPU, (TIME_S, TIME_S))
        allowed = _address_space() + MEMORY  # the process this one was forked from may be large
        resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
        os.environ["HOME"] = str(folder)
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_RDWR), 1)
        os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT), 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        warnings.simplefilter("default")
        code = greenhouse.main(words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(code)


def _address_space() -> int:
    """Bytes that this process has mapped."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 200, "files", __doc__))
