"""Hourly costs from a rig's samples, and from a server that answers as VictoriaMetrics does."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

import pytest

from edge.core.errors import DataError
from edge.lab.cost import step_cost
from fleet.rollout.blocks import AIR, DUTY, FAN, REFERENCE, Samples, costs_from, hourly
from fleet.rollout.judge import HOUR_S
from fleet.settings import NumbersSettings

BEGIN_S = 500_000 * HOUR_S


def samples(
    minutes: int, error_k: float = 0.5, duty: float = 0.4, fan: float = 0.0
) -> dict[str, dict[int, float]]:
    times = [round(1000 * (BEGIN_S + 60 * k)) for k in range(minutes + 1)]
    values = {AIR: 25.0 + error_k, REFERENCE: 25.0, DUTY: duty, FAN: fan}
    return {name: dict.fromkeys(times, value) for name, value in values.items()}


def test_a_cost_is_that_of_the_papers_controller() -> None:
    (hour,) = hourly(samples(60, error_k=0.5, duty=0.4, fan=0.25))
    assert hour.begin_utc == BEGIN_S
    assert hour.cost == pytest.approx(step_cost(0.5, 0.4, 0.25))


def test_the_error_of_a_step_is_that_of_the_air_at_its_end() -> None:
    found = samples(60, error_k=0.0, duty=0.0)
    last = max(found[AIR])
    found[AIR][last] = 26.0  # 1 K off after the last step
    (hour,) = hourly(found)
    assert hour.cost == pytest.approx(step_cost(1.0, 0.0, 0.0) / 60.0)


def test_an_hour_with_too_few_steps_has_no_cost() -> None:
    assert hourly(samples(40)) == []
    gap = samples(60)
    for at in sorted(gap[REFERENCE])[10:40]:
        del gap[REFERENCE][at]
    assert hourly(gap) == []


@contextmanager
def serving(series: Samples, status: int = 200) -> Iterator[tuple[str, list[dict[str, list[str]]]]]:
    """Address of a server, and what it was asked."""
    asked: list[dict[str, list[str]]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            parts = urlsplit(self.path)
            assert parts.path == "/vm/api/v1/export"
            asked.append(parse_qs(parts.query))
            self.send_response(status)
            self.end_headers()
            for name, own in series.items():
                row = {
                    "metric": {"__name__": name, "rig": "rig-1"},
                    "values": [*own.values(), None],
                    "timestamps": [*own, 1],
                }
                self.wfile.write(json.dumps(row).encode() + b"\n")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/vm", asked
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def test_costs_are_read_from_the_numbers_of_one_rig() -> None:
    with serving(samples(180)) as (url, asked):
        found = costs_from(NumbersSettings(url=url))("rig-1", BEGIN_S, BEGIN_S + 2 * HOUR_S)
    assert [hour.begin_utc for hour in found] == [BEGIN_S, BEGIN_S + HOUR_S]
    assert asked[0]["match[]"] == [f'{{__name__=~"{AIR}|{REFERENCE}|{DUTY}|{FAN}",rig="rig-1"}}']
    assert float(asked[0]["end"][0]) > BEGIN_S + 2 * HOUR_S  # the last step ends after it


def test_a_server_that_refuses_or_is_away_is_named() -> None:
    with (
        serving({}, status=503) as (url, _),
        pytest.raises(DataError, match=r"numbers\.url: .*/api/v1/export: 503"),
    ):
        costs_from(NumbersSettings(url=url))("rig-1", BEGIN_S, BEGIN_S + HOUR_S)
    with pytest.raises(DataError, match=r"numbers\.url: http://127"):
        costs_from(NumbersSettings(url=url))("rig-1", BEGIN_S, BEGIN_S + HOUR_S)
