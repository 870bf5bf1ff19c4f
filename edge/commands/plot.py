"""`greenhouse plot --out PICTURE [RUN]`: a run file or a stretch of the history, laid out as in the paper."""

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge.commands.arguments import add_bounds, bounds, writing
from edge.commands.which_rig import history_of
from edge.core.errors import RequestError
from edge.core.messages import Event, Severity
from edge.diagnosis.report.picture import time_axis
from edge.formats.run_file import RecordedRun, read_run
from edge.formats.run_lines import OPTION_WITHOUT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Floats = NDArray[np.float64]

WIDTH_IN = 10.0
PANEL_IN = {"temperature": 3.2, "fan": 0.5, "heater": 1.3}
BORDER_IN = 1.2  # legend, time axis, spaces
LINE_IN = 0.18  # height of one line of small text
SMALL = 8  # its size [pt]
LISTED_MAX = 10  # events with their texts; more are drawn, and counted
LINE_CHARS = 145  # what fits into the width
NUMBER_GAP = 0.03  # two numbers stand at least this share of the width apart, else they are written as one
COLORS = {Severity.ALARM: "#c0392b", Severity.WARNING: "#d68910", Severity.INFO: "#707b7c"}


def plot_history(path: str | Path, since_utc: float | None, until_utc: float | None, out: str | Path) -> None:
    """Draw a stretch of the history with its events. Errors: DataError, RequestError, OSError"""
    from edge.storage.runs import events_between, export_run

    run = export_run(path, since_utc=since_utc, until_utc=until_utc)
    start_utc = run.start_utc or 0.0  # a stretch of the history always says it
    plot_run(run, out, events_between(path, start_utc, start_utc + float(run.columns["time_s"][-1])))


def plot_run(run: RecordedRun, out: str | Path, events: Sequence[Event] = ()) -> None:
    """Draw a run. The ending of `out` gives the kind (.png, .svg, .pdf).

    events : placed by their `utc`, and so only for a run that says when it began
    Errors : RequestError without matplotlib or for an unknown kind; OSError
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise RequestError(f"pictures need matplotlib: {sys.executable} -m pip install matplotlib")
    told = sorted(events, key=lambda event: event.utc) if run.start_utc is not None else []
    try:
        _draw(run, told).savefig(out, dpi=150)
    except ValueError as error:  # an ending that it does not know
        raise RequestError(f"{out}: {error}") from error


def _draw(run: RecordedRun, events: Sequence[Event]) -> "Figure":
    """Panels above one another with one time axis, and the events' texts below them."""
    from matplotlib.figure import Figure

    lines = _event_lines(events)
    text_in = LINE_IN * max(len(lines), 0.1)
    panels = {name: height for name, height in PANEL_IN.items() if name != "fan" or "fan_on" in run.columns}
    picture_in = sum(panels.values()) + BORDER_IN
    figure = Figure(figsize=(WIDTH_IN, picture_in + text_in), layout="constrained")
    picture, text = figure.subfigures(2, 1, squeeze=False, height_ratios=(picture_in, text_in))[:, 0]
    columns = picture.subplots(len(panels), 1, sharex=True, height_ratios=list(panels.values()))
    axes: dict[str, Axes] = dict(zip(panels, columns, strict=True))

    divisor, unit = _unit(run)
    time = run.columns["time_s"] / divisor
    _draw_temperatures(axes["temperature"], run, time)
    if "fan" in axes:
        _draw_fan(axes["fan"], time, run.columns["fan_on"])
    _draw_heater(axes["heater"], time, run.columns["heater_duty"])
    _draw_events(list(axes.values()), run, events, divisor)
    # Above the panel and the numbers: never over a line.
    axes["temperature"].legend(loc="lower right", bbox_to_anchor=(1.0, 1.04), ncols=3, frameon=False)
    since = f" since {_clock(run.start_utc)} UTC" if run.start_utc is not None else ""
    axes["heater"].set_xlabel(f"time{since} [{unit}]")
    axes["heater"].set_xlim(0.0, time[-1] or 1.0)
    picture.align_ylabels()
    for number, (line, color) in enumerate(lines):
        text.text(
            0.01,
            1.0 - (number + 0.5) / len(lines),
            line,
            fontsize=SMALL,
            color=color,
            va="center",
            parse_math=False,
        )
    return figure


def _draw_temperatures(axes: "Axes", run: RecordedRun, time: Floats) -> None:
    if "reference_c" in run.columns:
        axes.step(
            time, run.columns["reference_c"], "--", where="post", color="black", lw=1.2, label="reference"
        )
    axes.plot(time, run.columns["temp_air_c"], color="#c0392b", lw=1.5, label="air")
    if "temp_ambient_c" in run.columns:
        axes.plot(time, run.columns["temp_ambient_c"], color="#2874a6", lw=1.0, label="ambient")
    axes.set_ylabel("temperature [°C]")
    axes.grid(alpha=0.3)


def _draw_fan(axes: "Axes", time: Floats, fan_on: Floats) -> None:
    axes.fill_between(time, fan_on, step="post", color="#117864", alpha=0.7, lw=0)
    axes.set_ylim(0.0, 1.05)
    axes.set_yticks([0.0, 1.0], ["off", "on"])
    axes.set_ylabel("fan")


def _draw_heater(axes: "Axes", time: Floats, duty: Floats) -> None:
    axes.fill_between(time, duty, step="post", color="#ca6f1e", alpha=0.35, lw=0)
    axes.step(time, duty, where="post", color="#ca6f1e", lw=0.8)
    # Each row holds to the next, the last one for no time.
    held = np.diff(time)
    mean = float(np.average(duty[:-1], weights=held)) if len(held) else float(duty[0])
    axes.axhline(mean, ls="--", color="black", lw=1.0, label=f"average {mean:.2f}")
    axes.set_ylim(0.0, 1.05)
    axes.set_ylabel("heater duty [0..1]")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.93), frameon=False)


def _draw_events(panels: list["Axes"], run: RecordedRun, events: Sequence[Event], divisor: float) -> None:
    """Draw a line through all panels for each event, with the numbers of the listed ones above."""
    start_utc = run.start_utc or 0.0
    for event in events:
        for axes in panels:
            time = (event.utc - start_utc) / divisor
            axes.axvline(time, color=COLORS[event.severity], lw=0.8, alpha=0.6, zorder=0)
    gap_s = NUMBER_GAP * float(run.columns["time_s"][-1])
    for first, group in _groups(_gravest(events), gap_s):
        middle = (group[0].utc + group[-1].utc) / 2.0 - start_utc
        panels[0].annotate(
            f"{first}–{first + len(group) - 1}" if len(group) > 1 else str(first),
            (middle / divisor, 1.0),
            (0.0, 3.0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
            color=COLORS[min((event.severity for event in group), key=list(COLORS).index)],
        )


def _groups(events: Sequence[Event], gap_s: float) -> list[tuple[int, list[Event]]]:
    """Events whose numbers would overlap, together; each group with its first number."""
    groups: list[tuple[int, list[Event]]] = []
    for number, event in enumerate(events, start=1):
        if groups and event.utc - groups[-1][1][-1].utc < gap_s:
            groups[-1][1].append(event)
        else:
            groups.append((number, [event]))
    return groups


def _gravest(events: Sequence[Event]) -> list[Event]:
    """Return the gravest events, in the order of time."""
    gravest = sorted(events, key=lambda event: list(COLORS).index(event.severity))[:LISTED_MAX]
    return sorted(gravest, key=lambda event: event.utc)


def _event_lines(events: Sequence[Event]) -> list[tuple[str, str]]:
    """Text and colour of each line below the picture."""
    listed = _gravest(events)
    lines = [
        (_cut(f"{number} {_clock(event.utc)} {event.key}: {event.text}"), COLORS[event.severity])
        for number, event in enumerate(listed, start=1)
    ]
    if len(events) > len(listed):
        lines.append((f"and {len(events) - len(listed)} more", COLORS[Severity.INFO]))
    return lines


def _unit(run: RecordedRun) -> tuple[float, str]:
    length_s = float(run.columns["time_s"][-1])
    return time_axis(length_s)


def _cut(line: str) -> str:
    line = " ".join(line.split())
    return line if len(line) <= LINE_CHARS else line[: LINE_CHARS - 1] + "…"


def _clock(utc: float) -> str:
    return datetime.fromtimestamp(utc, UTC).strftime("%Y-%m-%d %H:%M")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("run_file", type=Path, nargs="?", metavar="RUN", help="run file; else the history")
    add_bounds(parser)
    parser.add_argument(
        "--out", type=Path, required=True, help="picture: .png, .svg or .pdf; needs matplotlib"
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when the picture is written."""
    if arguments.run_file is not None and (arguments.since is not None or arguments.until is not None):
        raise RequestError("--since and --until are for the history; a run file is drawn whole")
    with writing(arguments.out):
        if arguments.run_file is not None:
            plot_run(read_run(arguments.run_file, OPTION_WITHOUT), arguments.out)
        else:
            history = history_of(arguments.history)
            plot_history(history, *bounds(arguments, history), arguments.out)
    print(arguments.out)
    return 0
