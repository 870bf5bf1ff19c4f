"""A client of VictoriaMetrics (one node, addressed directly) by its HTTP interface.

Its memory is on disk after some seconds only, and a kill loses what is not: `/internal/force_flush` makes
samples readable, no more. Creating a snapshot writes all of them and syncs, so each batch ends with one.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

from edge.core.errors import DataError
from edge.core.plain_text import plain
from fleet.numbers.series import any_series
from fleet.settings import NumbersSettings

TIMEOUT_S = 30.0  # a snapshot of a large store takes seconds
DROPPED = (  # what counters of samples that were not stored begin with
    *("vm_rows_ignored_total", "vm_rows_invalid_total"),
    *("vm_hourly_series_limit_rows_dropped_total", "vm_daily_series_limit_rows_dropped_total"),
)
FIELDS = "metric", "values", "timestamps"


class NumbersError(DataError):
    """VictoriaMetrics can't be reached or refuses; the text names the setting and says why."""


@dataclass(frozen=True, slots=True)
class NumberSeries:
    """One series as it was read.

    labels : with `__name__`; utc : [n] of its samples [s since 1970], rising; values : [n]
    """

    labels: Mapping[str, str]
    utc: tuple[float, ...]
    values: tuple[float, ...]


class Numbers:
    """Samples in and out. Any thread; every call has a connection of its own.

    timeout_s : of each answer
    Errors : NumbersError from every method
    """

    def __init__(self, settings: NumbersSettings, timeout_s: float = TIMEOUT_S) -> None:
        self._url, self._timeout_s = settings.url, timeout_s
        parts = urlsplit(settings.url)
        self._kind = HTTPSConnection if parts.scheme == "https" else HTTPConnection
        self._host, self._port, self._root = parts.hostname or "", parts.port, parts.path.rstrip("/")

    def store(self, lines: str) -> None:
        """Write samples and return once they are on disk.

        lines : of `fleet.numbers.series.lines`; a sample that is there already stays one by
        `-dedup.minScrapeInterval=1ms`, so after an error the same lines may be written again
        """
        # All over one connection: where the server was started anew in between, it breaks, and the samples
        # that the old one held in memory are not taken for stored.
        with self._connection() as connection:
            self._call(connection, "POST", "/api/v1/import/prometheus", lines.encode())
            self._sync(connection)

    def erase(self, rig: str) -> None:
        """Delete every series of a rig, and return once that is on disk; of one without any, nothing."""
        asked = urlencode({"match[]": any_series(rig)})
        with self._connection() as connection:
            self._call(connection, "POST", f"/api/v1/admin/tsdb/delete_series?{asked}")
            self._sync(connection)

    def series(self, selector: str, first_utc: float, last_utc: float) -> Iterator[NumberSeries]:
        """Yield the series of a selector with their samples, both ends included; a null is none."""
        # Both ends are sent: without an end samples of the present second are left out.
        asked = urlencode({"match[]": selector, "start": first_utc, "end": last_utc})
        with self._connection() as connection:
            for line in self._call(connection, "GET", f"/api/v1/export?{asked}").splitlines():
                labels, values, at_ms = (self._json(line)[name] for name in FIELDS)
                known = [(ms, value) for ms, value in zip(at_ms, values, strict=True) if value is not None]
                yield NumberSeries(
                    labels, tuple(ms / 1000 for ms, _ in known), tuple(value for _, value in known)
                )

    def query(self, promql: str, at_utc: float) -> list[tuple[Mapping[str, str], float]]:
        """Return labels and value of each series that an expression has at a time."""
        asked = urlencode({"query": promql, "time": at_utc})
        with self._connection() as connection:
            answer = self._json(self._call(connection, "GET", f"/api/v1/query?{asked}"))
        return [(row["metric"], float(row["value"][1])) for row in answer["data"]["result"]]

    def query_range(
        self, promql: str, first_utc: float, last_utc: float, step_s: float
    ) -> list[NumberSeries]:
        """Return the series of an expression on a grid from `first_utc` on."""
        # Without a cache: the newest ticks, and late ones, belong to it.
        asked = {"query": promql, "start": first_utc, "end": last_utc, "step": step_s, "nocache": 1}
        with self._connection() as connection:
            answer = self._json(self._call(connection, "GET", f"/api/v1/query_range?{urlencode(asked)}"))
        return [_on_grid(row) for row in answer["data"]["result"]]

    def dropped_rows(self) -> Mapping[str, float]:
        """Return how many samples the server has dropped since its start, by the name of its counter."""
        with self._connection() as connection:
            text = self._call(connection, "GET", "/metrics").decode(errors="replace")
        rows = (line.rpartition(" ") for line in text.splitlines() if line.startswith(DROPPED))
        return {name: float(value) for name, _, value in rows if float(value) > 0}

    def options(self) -> Mapping[str, str]:
        """Return what the server was started with, by option."""
        with self._connection() as connection:
            text = self._call(connection, "GET", "/flags").decode(errors="replace")
        rows = (line.removeprefix("-").partition("=") for line in text.splitlines())
        return {name: value.strip('"') for name, _, value in rows}

    def _sync(self, connection: HTTPConnection) -> None:
        made = self._json(self._call(connection, "GET", "/snapshot/create"))
        if made.get("status") != "ok":
            raise self._error(f"no snapshot: {made.get('msg')}")
        self._call(connection, "GET", f"/snapshot/delete?snapshot={quote(str(made['snapshot']))}")

    @contextmanager
    def _connection(self) -> Iterator[HTTPConnection]:
        connection = self._kind(self._host, self._port, timeout=self._timeout_s)
        try:
            connection.connect()
            connection.auto_open = 0  # http.client would connect anew without a word
            yield connection
        except (OSError, HTTPException) as error:
            raise self._error(str(error) or type(error).__name__) from None
        finally:
            connection.close()

    def _call(self, connection: HTTPConnection, method: str, path: str, body: bytes | None = None) -> bytes:
        connection.request(method, self._root + path, body)
        with connection.getresponse() as response:
            content = response.read()
        if response.status not in (200, 204):
            said = f"{response.status} {content[:500].decode(errors='replace')}"
            raise self._error(f"{path.partition('?')[0]}: {said}")
        return content

    def _json(self, content: bytes) -> dict[str, Any]:
        try:
            return dict(json.loads(content))
        except ValueError:
            raise self._error(f"no JSON: {content[:100].decode(errors='replace')}") from None

    def _error(self, why: str) -> NumbersError:
        return NumbersError(f"numbers.url: {self._url}: {plain(why)}")


def _on_grid(row: Mapping[str, Any]) -> NumberSeries:
    pairs = [(float(utc), float(value)) for utc, value in row["values"]]
    return NumberSeries(row["metric"], tuple(utc for utc, _ in pairs), tuple(value for _, value in pairs))
