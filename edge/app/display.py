"""Live display: a line per tick, or on a terminal a page that redraws itself (rich, imported late)."""

import textwrap
from collections import deque
from collections.abc import Mapping
from datetime import datetime
from typing import IO, TYPE_CHECKING, Any, cast

from edge.app.live_page import EVENTS_SHOWN, MODELS_MIN, page
from edge.app.outlet import Outlet
from edge.core.messages import Event, TickRecord
from edge.formats.tick_json import tick_json

if TYPE_CHECKING:
    from rich.console import RenderableType

TICKS_KEPT = 500  # more than the columns of a terminal


def tick_line(tick: Mapping[str, Any], columns: int | None = None) -> str:
    """One tick, in the form of `edge.formats.tick_json`, on one line.

    columns : of the terminal; a line that is longer leaves out the forecasts and is folded
    """
    air = tick["readings"].get("temp_air_c", {"value": None, "quality": "absent"})
    shown = f"{air['value']:5.1f}" if air["value"] is not None else f"({air['quality']})"
    rules = ",".join(dict.fromkeys(change["rule"] for change in tick["changes"])) or "-"
    forecast = " ".join(f"{value:.1f}" for value in tick["forecast_c"][:3]) or "-"
    facts = (
        f"{_clock(tick['utc'])}  tick {tick['seq']:<5d} air {shown} degC  ref {tick['reference_c']:4.1f}"
        f"  heater {tick['sent']['heater_duty']:4.2f}  fan {'on ' if tick['sent']['fan_on'] else 'off'}"
        f"  {tick['controller']:<7s}"
    )
    expected = f" forecast {forecast}{_models(tick['forecasts'])}"
    rest = "".join([f"  safety {rules}", *(f"  ! {event['text']}" for event in tick["events"])])
    line = f"{facts}{expected}{rest}"
    if columns is None or len(line) <= columns:
        return line
    short = facts.rstrip() + (rest if tick["changes"] or tick["events"] else "")
    return textwrap.fill(short, columns, subsequent_indent=" " * 10, break_on_hyphens=False)


def _models(forecasts: Mapping[str, Any]) -> str:
    """Return each model's forecast for MODELS_MIN, "" without any."""
    expected = {
        name: forecast["temp_c"][str(MODELS_MIN)]
        for name, forecast in forecasts.items()
        if str(MODELS_MIN) in forecast["temp_c"]
    }
    if not expected:
        return ""
    return f"  in {MODELS_MIN} min " + " ".join(f"{name} {temp:.1f}" for name, temp in expected.items())


class LineDisplay:
    """A sink of tick records for logs and pipes."""

    def __init__(self, out: Outlet) -> None:
        self._out = out

    def write(self, record: TickRecord) -> None:
        """Print the tick, in the outlet's thread."""
        self._out.write_later(lambda: tick_line(tick_json(record)) + "\n")

    def faults(self) -> Mapping[str, str]:
        """Return the outlet's faults."""
        return self._out.faults()

    def close(self) -> None:
        """Nothing to give back."""


class PageDisplay:
    """A sink of tick records for terminals: chart, facts, events. Draws in rich's own thread."""

    def __init__(self, out: Outlet, footer: str = "") -> None:
        from rich.console import Console
        from rich.live import Live

        self._out, self._footer = out, footer
        self._records: deque[TickRecord] = deque(maxlen=TICKS_KEPT)
        self._events: deque[Event] = deque(maxlen=EVENTS_SHOWN)
        self._live = Live(
            console=Console(file=cast("IO[str]", out)),
            get_renderable=self._page,
            refresh_per_second=8,
            screen=False,
        )
        self._live.start()

    def write(self, record: TickRecord) -> None:
        """Take the tick; the next redraw shows it."""
        self._records.append(record)
        self._events.extend(record.events)

    def faults(self) -> Mapping[str, str]:
        """Return the outlet's faults."""
        return self._out.faults()

    def close(self) -> None:
        """Leave the last page on the screen."""
        self._live.stop()

    def _page(self) -> "RenderableType":
        from rich.text import Text

        if not self._records:
            return Text("waiting for the first tick ...")
        size = self._live.console.size
        # One row less than there are: the cursor stands below, and a higher page would scroll.
        lines = page(list(self._records), list(self._events), size.width, size.height - 1, self._footer)
        return Text("\n", no_wrap=True).join(Text(text, style, no_wrap=True) for style, text in lines)


def _clock(utc: float) -> str:
    return datetime.fromtimestamp(utc).strftime("%H:%M:%S")


def make_display(out: Outlet, footer: str = "") -> LineDisplay | PageDisplay:
    """Return the page on a terminal, with `footer` as its last line, and lines anywhere else."""
    return PageDisplay(out, footer) if out.isatty() else LineDisplay(out)
