"""Options of VictoriaMetrics without which ticks would be there twice, or not at all."""

import pytest

from fleet.ingest.loop import days, problem

RIGHT = {"dedup.minScrapeInterval": "1ms", "retentionPeriod": "10y"}


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
