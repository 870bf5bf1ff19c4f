"""Pictures of runs: what is drawn, and that no odd run stops it."""

import importlib.util
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from history_records import START_UTC, eventful_tick, store, tick

from edge.commands import plot
from edge.core.errors import DataError, RequestError
from edge.core.messages import Event, Severity
from edge.formats.run_file import RecordedRun

PNG = b"\x89PNG\r\n\x1a\n"


def run_of(rows: int, **columns: list[float]) -> RecordedRun:
    base = {
        "time_s": 60.0 * np.arange(rows),
        "temp_air_c": 20.0 + np.arange(rows),
        "heater_duty": np.linspace(0.0, 1.0, rows),
    }
    return RecordedRun(
        {**base, **{key: np.array(value) for key, value in columns.items()}},
        {"start_utc": "2026-01-01T00:00:00Z"},
    )


def event(utc_s: float, severity: Severity = Severity.WARNING, text: str = "text") -> Event:
    return Event("some.thing", severity, text, math.nan, START_UTC + utc_s)


def test_a_stretch_of_history_becomes_a_picture(tmp_path: Path) -> None:
    ticks = (eventful_tick(seq) if seq == 9 else tick(seq) for seq in range(1, 20))
    store(tmp_path / "history.db", *ticks)
    plot.plot_history(tmp_path / "history.db", None, None, tmp_path / "out.png")
    assert (tmp_path / "out.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    "run",
    [
        run_of(1),
        run_of(3, temp_air_c=[math.nan] * 3),
        run_of(3, fan_on=[0.0, 1.0, 0.0], reference_c=[21.0] * 3, temp_ambient_c=[20.0, math.nan, 20.0]),
    ],
    ids=["one row", "no temperature", "all columns"],
)
def test_odd_runs_become_pictures_too(tmp_path: Path, run: RecordedRun) -> None:
    plot.plot_run(run, tmp_path / "out.png", [event(0.0, text="costs $5 or $\\x")])
    assert (tmp_path / "out.png").read_bytes().startswith(PNG)


def test_the_panels_show_what_the_run_has() -> None:
    figure = plot._draw(run_of(3), [])
    assert [axes.get_ylabel() for axes in figure.axes] == ["temperature [°C]", "heater duty [0..1]"]
    figure = plot._draw(run_of(3, fan_on=[0.0, 1.0, 0.0]), [])
    assert [axes.get_ylabel() for axes in figure.axes] == ["temperature [°C]", "fan", "heater duty [0..1]"]
    assert figure.axes[-1].get_xlabel() == "time since 2026-01-01 00:00 UTC [s]"


def test_the_heaters_average_weighs_each_row_by_how_long_it_held() -> None:
    run = run_of(3, time_s=[0.0, 10.0, 40.0], heater_duty=[1.0, 0.2, 0.9])
    legend = plot._draw(run, []).axes[-1].get_legend()
    assert legend is not None
    assert legend.get_texts()[0].get_text() == "average 0.40"  # (10 * 1.0 + 30 * 0.2) / 40


@pytest.mark.parametrize(
    ("length_s", "unit"), [(0, "s"), (299, "s"), (300, "min"), (10799, "min"), (10800, "h"), (172800, "days")]
)
def test_the_time_axis_has_a_fitting_unit(length_s: float, unit: str) -> None:
    assert plot._unit(run_of(2, time_s=[0.0, length_s]))[1] == unit


def test_the_gravest_events_are_listed_and_the_rest_counted() -> None:
    infos = [event(float(i), Severity.INFO) for i in range(plot.LISTED_MAX)]
    alarm = event(99.0, Severity.ALARM, "the alarm")
    lines = [line for line, _ in plot._event_lines([*infos, alarm])]
    assert len(lines) == plot.LISTED_MAX + 1
    assert lines[-2] == "10 2026-01-01 00:01 some.thing: the alarm"
    assert lines[-1] == "and 1 more"


def test_numbers_that_would_overlap_are_written_as_one() -> None:
    groups = plot._groups([event(0.0), event(5.0), event(15.0), event(24.9)], gap_s=10.0)
    assert [(number, len(group)) for number, group in groups] == [(1, 2), (3, 2)]


def test_long_and_broken_texts_stay_in_one_line() -> None:
    ((line, _),) = plot._event_lines([event(0.0, text="a\nb " + "x" * 500)])
    assert len(line) == plot.LINE_CHARS
    assert "\n" not in line


def test_a_kind_of_picture_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"out\.xyz"):
        plot.plot_run(run_of(3), tmp_path / "out.xyz")


def test_a_stretch_without_ticks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError):
        plot.plot_history(tmp_path / "none.db", None, None, tmp_path / "out.png")


def test_without_matplotlib_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RequestError, match=f"{re.escape(sys.executable)} -m pip install matplotlib"):
        plot.plot_run(run_of(3), tmp_path / "out.png")
