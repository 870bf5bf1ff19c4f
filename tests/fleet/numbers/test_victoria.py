"""VictoriaMetrics as a store: what was stored survives a kill, once, and what it says is read."""

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from fleet.ingest.loop import days, problem
from fleet.numbers.series import head, lines, selector
from fleet.numbers.victoria import Numbers, NumbersError
from fleet.settings import NumbersSettings
from tests.support.broker import free_port, wait_for
from tests.support.victoria import Victoria, needs_victoria

RIGHT = {"dedup.minScrapeInterval": "1ms", "retentionPeriod": "10y"}
SAMPLES = ((head("temp_air_c"), 21.5), (head("forecast_temp_c", predictor="arx", horizon_min=5), 22.25))


@pytest.mark.parametrize(
    ("period", "expected"),
    [("1", 31.0), ("48h", 2.0), ("1.5d", 1.5), ("2w", 14.0), ("10y", 3650.0), ("", 0.0), ("x", 0.0)],
)
def test_a_period_is_read_as_victoria_metrics_does(period: str, expected: float) -> None:
    assert days(period) == expected


def test_the_right_options_are_no_problem() -> None:
    assert problem(RIGHT, 3650.0) == ""


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"dedup.minScrapeInterval": "0s"}, "minScrapeInterval=0s: must be 1ms"),
        ({"dedup.minScrapeInterval": "1m"}, "minScrapeInterval=1m: must be 1ms"),
        ({"retentionPeriod": "1"}, "keeps 31 days, but numbers.retention_days is 3650"),
        ({"retentionPeriod": "soon"}, "keeps 0 days"),
    ],
)
def test_a_wrong_one_is_named(changes: dict[str, str], text: str) -> None:
    assert text in problem({**RIGHT, **changes}, 3650.0)


def read(numbers: Numbers, quantity: str, rig: str = "rig-1") -> list[tuple[float, float]]:
    found = numbers.series(selector(quantity, rig=rig), 0.0, time.time() + 60.0)
    return [pair for series in found for pair in zip(series.utc, series.values, strict=True)]


@pytest.fixture
def victoria(tmp_path: Path) -> Iterator[Victoria]:
    with Victoria(tmp_path) as own:
        yield own


@needs_victoria
@pytest.mark.slow
def test_what_was_stored_is_there_once_after_kills(victoria: Victoria) -> None:
    numbers, start = Numbers(NumbersSettings(url=victoria.url)), round(time.time(), 3) - 10.0
    times = [round(start + 0.5 * number, 3) for number in range(10)]
    for utc in (*times, *times):  # each twice
        numbers.store(lines("rig-1", utc, SAMPLES))
    victoria.kill()
    victoria.start()
    assert read(numbers, "temp_air_c") == [(utc, 21.5) for utc in times]
    assert read(numbers, "forecast_temp_c") == [(utc, 22.25) for utc in times]
    found = numbers.query(f"count_over_time({selector('temp_air_c', rig='rig-1')}[1h])", time.time() + 1.0)
    assert [value for _, value in found] == [10.0]


@needs_victoria
@pytest.mark.slow
def test_samples_that_it_drops_are_counted(victoria: Victoria) -> None:
    numbers = Numbers(NumbersSettings(url=victoria.url))
    numbers.store(lines("rig-1", time.time(), SAMPLES))
    assert numbers.dropped_rows() == {}
    numbers.store(lines("rig-1", time.time() + 10 * 86400.0, SAMPLES))
    wait_for(lambda: list(numbers.dropped_rows().values()) == [2.0])  # it counts once a second


@needs_victoria
@pytest.mark.slow
def test_a_query_that_is_wrong_is_refused_with_its_words(victoria: Victoria) -> None:
    with pytest.raises(NumbersError, match=r"/api/v1/query: 422 .*"):
        Numbers(NumbersSettings(url=victoria.url)).query("sum(", time.time())


def test_a_server_that_is_away_is_named() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with pytest.raises(NumbersError, match=f"numbers.url: {url}: .*refused"):
        Numbers(NumbersSettings(url=url)).store("")


class RestartedServer(BaseHTTPRequestHandler):
    """Takes samples, and is another server for each request, as after a kill."""

    asked: list[str] = []  # noqa: RUF012  of all its objects

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.asked.append(self.path)
        self.send_response(204)
        self.send_header("Connection", "close")
        self.end_headers()

    def do_GET(self) -> None:
        self.asked.append(self.path)
        self.send_error(500)

    def log_message(self, *_: object) -> None:
        pass


def test_samples_are_not_stored_when_the_server_was_another_before_their_snapshot() -> None:
    with HTTPServer(("127.0.0.1", 0), RestartedServer) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            url = f"http://127.0.0.1:{server.server_address[1]}"
            with pytest.raises(NumbersError):
                Numbers(NumbersSettings(url=url)).store("a 1 1\n")
        finally:
            server.shutdown()
            thread.join()
    assert RestartedServer.asked == ["/api/v1/import/prometheus"]
