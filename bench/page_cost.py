"""python -m bench.page_cost: the page on a year of history, its first paint, and a day in an open browser.

year: each request of the page on a history as the daemon keeps it for a year by default. The first look is of
a page that has just started; later looks find older blocks read. The peer is SQLite in this process, a SELECT
of all rows that the course stands for.
paint: Chromium as a phone of 360 px with an empty cache, on loopback, its processor slowed down.
day: as many ticks as 24 h have, in minutes, with the memory of browser and page on the way.
"""

import argparse
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from bench.default_daemon import memory_of
from bench.history_year import DAY_S, recorded_ticks
from edge.core.messages import TickRecord
from edge.page.access import DAY_S as LINK_S
from edge.page.access import Role
from tests.support.broker import wait_for
from tests.support.browser import PHONE, browser
from tests.support.browser_memory import (
    BrowserMemory,
    browser_memory,
    count_pushes,
    courses,
    pushes,
    wait_for_pushes,
)
from tests.support.page_process import Client, page_of
from tests.support.quick_daemon import quick_rig
from tests.support.year_history import build_year

AGAIN = 15  # later looks
HOUR_S = 3600.0
SPANS = {
    "1 h": HOUR_S,
    "6 h": 6 * HOUR_S,
    "1 day": DAY_S,
    "7 days": 7 * DAY_S,
    "30 days": 30 * DAY_S,
    "90 days": 90 * DAY_S,
    "a year": 365 * DAY_S,
}
BACK = {"now": 0.0, "60 days ago": 60 * DAY_S, "200 days ago": 200 * DAY_S}
BUTTONS = ("1 h", "6 h", "1 day", "7 days")  # spans that the page has a button for
POINTS = 1000
PEER = (
    "SELECT t.utc, a.value, t.estimate_temp_air_c, t.reference_c, t.estimate_temp_ambient_c,"
    " t.echo_heater_duty, t.echo_fan_on FROM ticks t"
    " LEFT JOIN readings a ON a.seq = t.seq AND a.signal = 'temp_air_c'"
    " WHERE t.utc >= ? AND t.utc < ?",
    "SELECT start_utc, quantity, mean, low, high FROM ten_minutes WHERE start_utc >= ? AND start_utc < ?",
)
DAY_TICKS, LOOKS_A_TICK = 1440, 20
LOOK_S = 0.012
SHARES = (0.05, 0.25, 0.5, 0.75, 1.0)  # of the day, after which memory is looked at
SETTLE_S = 3.0
SLOWER = 4
# Notes when a line is drawn for the first time after the course has come.
_WATCH_CHART = """
    const stroke = CanvasRenderingContext2D.prototype.stroke;
    CanvasRenderingContext2D.prototype.stroke = function (...words) {
      if (window.courses && words[0] instanceof Path2D) window.drawn ??= performance.now();
      return stroke.apply(this, words);
    };
"""
_PAINTS = """
    const paint = performance.getEntriesByName("first-contentful-paint")[0].startTime;
    const all = [...performance.getEntriesByType("resource"), ...performance.getEntriesByType("navigation")];
    const files = all.filter((each) => !each.name.includes("/api/"));
    return [paint, window.drawn, files.reduce((sum, each) => sum + each.encodedBodySize, 0)];
"""


@dataclass(frozen=True, slots=True)
class CourseRequest:
    """One course as the page's chart asks for it: the span and half of it on each side, see `useCourse`."""

    name: str
    first_utc: float
    last_utc: float

    @classmethod
    def of(cls, span: str, back: str, newest_utc: float) -> "CourseRequest":
        """Return the request of a span that ends some time before the newest tick."""
        last_utc = newest_utc - BACK[back]
        margin_s = SPANS[span] / 2 if span in BUTTONS else 0.0
        until_utc = last_utc + (margin_s if BACK[back] else 1.0)
        return cls(f"course of {span}, {back}", last_utc - SPANS[span] - margin_s, until_utc)

    @property
    def address(self) -> str:
        """The address to ask."""
        return f"/api/course?from_utc={self.first_utc}&to_utc={self.last_utc}&points={POINTS}"

    def peer(self, path: Path) -> None:
        """Read the same rows."""
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
            for query in PEER:
                db.execute(query, (self.first_utc, self.last_utc)).fetchall()


def time_ms(call: Callable[[], object]) -> float:
    """Return the time that a call takes."""
    began = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - began)


def ask(client: Client, address: str) -> None:
    """Ask the page for something that it has."""
    assert client.get(address).ok, address


def year(folder: Path, days: int, starts: int) -> Iterator[str]:
    """Yield the table of requests."""
    path = folder / "history.db"
    with closing(sqlite3.connect(path)) as db:
        newest_utc = float(db.execute("SELECT max(utc) FROM ticks").fetchone()[0])
        counts = [
            f"{db.execute(f'SELECT count(*) FROM {table}').fetchone()[0]} rows of {table}"
            for table in ("ticks", "ten_minutes", "events")
        ]
    yield f"{days} days of history: {path.stat().st_size / 1e6:.0f} MB, {', '.join(counts)}"
    requests = [
        CourseRequest.of(span, back, newest_utc)
        for span in SPANS
        for back in (BACK if span in BUTTONS else ("now",))
    ]
    old_utc = newest_utc - BACK["200 days ago"]
    others = {
        "who asks": "/api/me",
        "how far back": "/api/span",
        "30 events": "/api/events?most=30",
        "30 alarms, of which there are none": "/api/events?least=alarm&most=30",
        "200 events before 200 days ago": f"/api/events?most=200&before_utc={old_utc}",
    }
    addresses = {request.name: request.address for request in requests} | others
    first: dict[str, list[float]] = {name: [] for name in addresses}
    again: dict[str, list[float]] = {}
    for _ in range(starts):
        with page_of(folder) as page:
            client = page.client(Role.VIEW, "guest")
            ask(client, "/api/me")
            for name, address in addresses.items():
                first[name].append(time_ms(partial(ask, client, address)))
                again[name] = [time_ms(partial(ask, client, address)) for _ in range(AGAIN)]
    peers = {
        request.name: statistics.median(time_ms(partial(request.peer, path)) for _ in range(starts))
        for request in requests
    }
    yield from _requests(first, again, peers)


def _requests(
    first: dict[str, list[float]], again: dict[str, list[float]], peers: dict[str, float]
) -> Iterator[str]:
    starts = len(next(iter(first.values())))
    yield f"first look of {starts} starts, {AGAIN} later looks; over HTTP, with the check of the session"
    yield ""
    yield f"{'':36} {'first look':^17} {'later looks':^17} {'peer':>7} {'first':>7} {'later':>7}"
    yield f"{'[ms]':36} {'median':>8} {'max':>8} {'median':>8} {'max':>8} {'':7} {'/ peer':>7} {'/ peer':>7}"
    for name, found in first.items():
        values = [statistics.median(found), max(found), statistics.median(again[name]), max(again[name])]
        ratios = [peers[name], *(values[place] / peers[name] for place in (0, 2))] if name in peers else []
        yield f"{name:36} {_row(values, 8, 1)} {_row(ratios, 7, 2)}".rstrip()
    slowest = {name: statistics.median(found) for name, found in again.items()}
    name = max(slowest, key=slowest.__getitem__)
    yield f"slowest of the later looks: {slowest[name]:.1f} ms, {name}"


def _row(values: Sequence[float], width: int, digits: int) -> str:
    return " ".join(f"{value:{width}.{digits}f}" for value in values)


def paint(address: str, rate: int) -> tuple[float, float, int]:
    """Return the times of the first contentful paint and of the drawn chart [ms], and the bytes that came."""
    with browser(PHONE) as driver:
        count_pushes(driver, _WATCH_CHART)
        driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": rate})
        driver.get(address)
        wait_for(lambda: driver.execute_script("return window.drawn"), "the chart", 60.0)
        first, drawn, size = driver.execute_script(_PAINTS)
    return first, drawn, size


def paints(folder: Path, template: Sequence[TickRecord], repeats: int) -> Iterator[str]:
    """Yield the table of first paints. The peer is the same browser at its full speed."""
    with quick_rig(folder, template, LOOKS_A_TICK, 1.0) as (_, page):
        link = page.access.make_link(Role.ADMIN, "Ann", LINK_S, None)
        found = {
            rate: [paint(f"{page.base}/#link={link}", rate) for _ in range(repeats)] for rate in (SLOWER, 1)
        }
    yield f"{f'{repeats} times, cold cache, 360 px [ms]':36} {'first paint':^17} {'chart drawn':^17}"
    yield f"{'':36} {'median':>8} {'max':>8} {'median':>8} {'max':>8}"
    medians = {}
    for rate, name in ((SLOWER, f"processor {SLOWER} times as slow"), (1, "peer: processor as it is")):
        columns = [[each[place] for each in found[rate]] for place in (0, 1)]
        medians[rate] = [statistics.median(column) for column in columns]
        values = [value for column in columns for value in (statistics.median(column), max(column))]
        yield f"{name:36} {_row(values, 8, 0)}"
    ratios = [slow / fast for slow, fast in zip(medians[SLOWER], medians[1], strict=True)]
    yield f"{'ratio of the medians':36} {ratios[0]:8.1f} {'':8} {ratios[1]:8.1f}"
    yield f"files of the page as they come, compressed: {found[1][0][2] / 1000:.1f} kB"


def day(folder: Path, template: Sequence[TickRecord], count: int) -> Iterator[str]:
    """Yield the table of memory while so many ticks come."""
    yield f"{count} ticks, {LOOKS_A_TICK} views each; memory after a collection of garbage"
    yield (
        f"{'ticks':>8} {'views':>8} {'courses':>8} {'heap [MB]':>10} {'nodes':>7} {'listeners':>10}"
        f" {'page PSS [MB]':>14}"
    )
    with quick_rig(folder, template, LOOKS_A_TICK, LOOK_S) as (daemon, page), browser(PHONE) as driver:
        assert page.process is not None
        count_pushes(driver)
        driver.get(f"{page.base}/#link={page.access.make_link(Role.ADMIN, 'Ann', LINK_S)}")
        found: list[tuple[BrowserMemory, float]] = []
        began = time.monotonic()
        for share in SHARES:
            wait_for_pushes(driver, round(share * count * LOOKS_A_TICK))
            daemon.is_still = True
            time.sleep(SETTLE_S)
            found.append((browser_memory(driver), memory_of(str(page.process.pid)).pss))
            daemon.is_still = False
            seen = f"{daemon.record.seq - daemon.first_seq:8} {pushes(driver):8} {courses(driver):8}"
            memory, pss = found[-1]
            yield f"{seen} {memory.heap_mb:10.2f} {memory.nodes:7} {memory.listeners:10} {pss:14.1f}"
    (first, first_pss), (last, last_pss) = found[0], found[-1]
    ratios = (last.heap_mb / first.heap_mb, last.nodes / first.nodes, last.listeners / first.listeners)
    name = f"end / after {SHARES[0]:.0%}"
    yield f"{name:>26} {ratios[0]:10.2f} {ratios[1]:7.2f} {ratios[2]:10.2f} {last_pss / first_pss:14.2f}"
    yield f"in {(time.monotonic() - began) / 60:.0f} min"


def report(parts: Sequence[str], days: int, repeats: int, count: int) -> Iterator[str]:
    """Yield the tables, line by line as they come."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        folder = Path(name)
        template = recorded_ticks(2.0)
        build_year(folder / "history.db", template, days)
        tables: dict[str, Callable[[], Iterator[str]]] = {
            "year": partial(year, folder, days, repeats),
            "paint": partial(paints, folder, template, repeats),
            "day": partial(day, folder, template, count),
        }
        for part, table in tables.items():
            if part in parts:
                yield from table()
                yield ""


def main() -> int:
    """Print the tables."""
    parts = ["year", "paint", "day"]
    parser = argparse.ArgumentParser(prog="python -m bench.page_cost", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts)
    parser.add_argument("--days", type=int, default=365, help="of history, 33 at least")
    parser.add_argument("--repeats", type=int, default=7, help="of first looks and first paints")
    parser.add_argument("--ticks", type=int, default=DAY_TICKS, help="in the open browser")
    given = parser.parse_args()
    print(f"python -m bench.page_cost {' '.join(sys.argv[1:])}")
    for line in report(given.parts, given.days, given.repeats, given.ticks):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
