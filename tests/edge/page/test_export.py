"""The history as a run file: the same bytes as the command writes, in bounded memory, one at a time."""

import asyncio
import socket
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from itertools import chain, repeat
from pathlib import Path

import pytest
from history_records import START_UTC, eventful_tick, store, tick

from edge.__main__ import main
from edge.commands.arguments import moment
from edge.core.errors import DataError
from edge.core.messages import Event, Reading, ReadingQuality, Severity
from edge.formats.run_file import read_run
from edge.page import export, history
from edge.page.access import DAY_S, Role
from edge.storage import run_rows
from edge.storage.runs import import_run
from tests.support.broker import wait_for
from tests.support.page_process import PageProcess, page_of

pytestmark = pytest.mark.slow
TICKS = 130_000
PAGE_MAX_KB = 60 << 10


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Two sessions with what may be odd, a signal that comes late, and somebody's run."""
    file = tmp_path / "history.db"
    late = {"soil_moisture": Reading("soil_moisture", 0.3, 0.0, ReadingQuality.GOOD)}
    store(file, *(tick(seq) for seq in range(1, 20)), eventful_tick(20))
    store(file, *(tick(seq, utc=START_UTC + 90.0 * seq) for seq in range(21, 40)), tick(40, readings=late))
    assert main(["export", "--history", str(file), "--out", str(tmp_path / "own.csv")]) == 0
    import_run(file, read_run(tmp_path / "own.csv"), "somebody's")
    return file


def by_command(path: Path, since: str, until: str) -> str:
    out = path.parent / "command.csv"
    assert (
        main(["export", "--history", str(path), "--since", since, "--until", until, "--out", str(out)]) == 0
    )
    return out.read_text()


def by_page(path: Path, since_utc: float, until_utc: float) -> Iterator[str]:
    return run_rows.run_text(path, since_utc, until_utc, partial(history.reading, path))


@pytest.mark.parametrize("rows", [1, 7, 1000])
@pytest.mark.parametrize(
    ("since", "until"),
    [
        ("2026-01-01", "2026-01-02"),
        ("2026-01-01T00:03", "2026-01-01T00:35:30"),
        ("2025-01-01", "2026-01-01T00:01"),
    ],
)
def test_the_page_exports_the_very_file_that_the_command_writes(
    path: Path, monkeypatch: pytest.MonkeyPatch, rows: int, since: str, until: str
) -> None:
    monkeypatch.setattr(run_rows, "ROWS_AT_ONCE", rows)
    first_utc, last_utc = moment(since), moment(until)
    assert first_utc and last_utc
    text = "".join(by_page(path, first_utc, last_utc))
    assert text == by_command(path, since, until)
    (path.parent / "page.csv").write_text(text)
    read_run(path.parent / "page.csv")


def test_a_stretch_that_cannot_be_exported_is_refused_before_the_first_piece(path: Path) -> None:
    with pytest.raises(DataError, match="there are no ticks in this stretch"):
        next(by_page(path, 1.0, 2.0))
    store(path, tick(41, utc=START_UTC + 60.0))
    with pytest.raises(DataError, match="tick 41: the wall clock went back"):
        next(by_page(path, START_UTC, START_UTC + DAY_S))


def test_a_reader_that_stalls_is_left_and_its_place_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "STALL_MAX_S", 0.05)
    sent = []

    class OnePlace:
        exports = True

    async def send(message: dict[str, object]) -> None:
        sent.append(message)
        if len(sent) == 3:
            await asyncio.Event().wait()

    async def receive() -> dict[str, str]:
        await asyncio.Event().wait()
        raise AssertionError

    place = OnePlace()
    answer = export._RunFile(place, chain(repeat("a row\n", 10)), START_UTC)
    asyncio.run(asyncio.wait_for(answer({"type": "http"}, receive, send), 20.0))
    assert len(sent) == 3  # and no end, which would call what is there the whole
    assert place.is_exporting is False


@pytest.fixture(scope="module")
def season() -> Iterator[PageProcess]:
    """A page whose history has a tick a minute for a season."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        file = Path(name) / "history.db"
        store(file, tick(1, events=(Event("board.link_lost", Severity.ALARM, "silent", 60.0, START_UTC),)))
        with closing(sqlite3.connect(file)) as db, db:
            for table in ("ticks", "readings"):
                columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
                new = {"seq": "n", "utc": f"{START_UTC} + 60.0 * n"}
                values = ", ".join(new.get(column, column) for column in columns)
                db.execute(
                    f"WITH RECURSIVE c(n) AS (SELECT 2 UNION ALL SELECT n + 1 FROM c WHERE n < {TICKS})"
                    f" INSERT INTO {table} SELECT {values} FROM {table}, c WHERE seq = 1"
                )
        with page_of(Path(name)) as page:
            yield page


SEASON = f"/api/export?from_utc={START_UTC}&to_utc={START_UTC + 91 * DAY_S}"


def test_a_season_takes_bounded_memory_and_nobody_waits_for_it(season: PageProcess) -> None:
    guest = season.client(Role.VIEW, "guest")
    with guest.session.get(season.base + SEASON, stream=True, timeout=120) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-disposition"] == 'attachment; filename="greenhouse_2026-01-01.csv"'
        lines = answer.iter_lines()
        assert next(lines).startswith(b"# start_utc: ")
        assert guest.get("/api/me").ok
        refused = season.client(Role.VIEW).get(SEASON)
        assert (refused.status_code, "another export" in refused.json()["error"]) == (503, True)
        rows = sum(line[:1].isdigit() for line in lines)
    assert rows == TICKS
    assert season.process is not None
    status = Path(f"/proc/{season.process.pid}/status").read_text()
    assert int(status.partition("VmHWM:")[2].split()[0]) < PAGE_MAX_KB
    wait_for(lambda: guest.get("/api/export?from_utc=1&to_utc=2").status_code == 404)


def test_whoever_hangs_up_or_stops_reading_leaves_the_page_as_it_was(season: PageProcess) -> None:
    guest = season.client(Role.VIEW, "guest")
    host, _, port = season.base.removeprefix("http://").partition(":")
    cookie = "; ".join(f"{each.name}={each.value}" for each in guest.session.cookies)
    with socket.create_connection((host, int(port))) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(f"GET {SEASON} HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie}\r\n\r\n".encode())
        assert connection.recv(15) == b"HTTP/1.1 200 OK"
        assert guest.get(SEASON).status_code == 503
        for _ in range(5):  # it reads no more, and holds up nobody
            assert guest.get("/api/view").ok
    wait_for(lambda: guest.get("/api/export?from_utc=1&to_utc=2").status_code == 404)


SPANS = ("", "from_utc=5&to_utc=5", "from_utc=9&to_utc=5", "from_utc=x&to_utc=5")
NO_TIMES = (
    "from_utc=-9e11&to_utc=5",
    "from_utc=0&to_utc=9e11",
    "from_utc=3e11&to_utc=4e11",
    "from_utc=-1&to_utc=5",
)


@pytest.mark.parametrize("route", ["export", "course"])
@pytest.mark.parametrize("span", [*SPANS, *NO_TIMES])
def test_a_span_that_is_none_is_refused_and_blocks_nobody(season: PageProcess, span: str, route: str) -> None:
    guest = season.client(Role.VIEW)
    answer = guest.get(f"/api/{route}?{span}")
    assert (answer.status_code, "utc" in answer.json()["error"]) == (400, True)
    assert guest.get("/api/export?from_utc=1&to_utc=2").status_code == 404


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("course?from_utc=0&to_utc=1e-320", 400),
        ("course?from_utc=1e11&to_utc=100000000001", 200),
        ("events?before_utc=-9e11", 400),
        ("why?at_utc=9e11", 400),
        ("export?from_utc=0&to_utc=1", 404),
    ],
)
def test_absurd_times_are_refused_by_every_route(season: PageProcess, path: str, status: int) -> None:
    assert season.client(Role.VIEW).get(f"/api/{path}").status_code == status


def test_an_alarm_is_acknowledged_once_it_exists_and_not_before(path: Path, season: PageProcess) -> None:
    assert [history.has_alarm(path, *place) for place in ((20, 0), (20, 1), (21, 0))] == [True, False, False]
    operator = season.client(Role.OPERATE)
    for place in ((1, 1), (2, 0), (TICKS + 1, 0), (1e11, 0)):
        answer = operator.post("/api/events/acknowledge", dict(zip(("seq", "number"), place, strict=True)))
        assert (answer.status_code, "there is no alarm" in answer.json()["error"]) == (400, True)
    assert operator.post("/api/events/acknowledge", {"seq": 1, "number": 0}).ok
    assert season.access.who_acknowledged(0) == {(1, 0): "Ann"}


def test_without_a_session_nothing_is_exported(season: PageProcess) -> None:
    assert season.client(None).get(SEASON).status_code == 401
