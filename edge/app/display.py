"""Live display: a line per tick, or on a terminal a page that redraws itself, as large as the terminal.

`rich` is imported late.
"""

import textwrap
from collections import deque
from collections.abc import Mapping
from datetime import datetime
from typing import IO, TYPE_CHECKING, Any, cast

from edge.app.outlet import Outlet
from edge.core.messages import Event, TickRecord
from edge.core.plain_text import fan_in_words
from edge.formats.tick_json import tick_json

if TYPE_CHECKING:
    from rich.console import RenderableType
from collections.abc import Iterator, Sequence

from edge.assistant.why.ask_history import reasons
from edge.core.messages import Severity
from edge.tick.orders import Mode

ALARM, QUIET, PLAIN = "bold red", "dim", ""  # styles
MODELS_MIN = 15  # horizon of the models' forecasts that are shown
CHART_ROWS = (4, 14)  # fewest that show a course, and most
EVENTS_SHOWN = 6
LABEL_COLUMNS = 6  # of the chart's axis
FORECAST_SHARE = 6  # a sixth of the chart's columns
TWO_COLUMNS_FROM = 72  # columns of the terminal

HEALTHY_MODES = tuple(mode.value for mode in Mode)  # not emergency_stop, not maintenance

Line = tuple[str, str]  # style and text, not longer than the terminal is wide


def page(
    records: Sequence[TickRecord], events: Sequence[Event], columns: int, rows: int, footer: str = ""
) -> list[Line]:
    """Return at most `rows` lines of at most `columns` characters.

    records : the last ticks, oldest first, at least one
    events : the last events, oldest first
    """
    newest = records[-1]
    top = [*_heading(newest), *_alarms(newest), *_facts(newest, columns), *_explanation(newest, columns)]
    shown = [_event(event) for event in events][-EVENTS_SHOWN:] or [(QUIET, "no events")]
    bottom = [(QUIET, footer)] if footer else []
    models = [(PLAIN, f"{name:<16s} {text}") for name, text in forecast_facts(newest)]
    room = rows - len(top) - len(bottom)
    # The newest two events are kept before there is a chart: an alarm may not fall off a small screen.
    latest = shown[-min(2, len(shown)) :]
    chart_room = room - len(latest)
    chart = []
    if chart_room > CHART_ROWS[0]:
        spare = max(0, chart_room - CHART_ROWS[0] - 1)
        models = models[: min(len(models), spare // 2)]
        height = min(CHART_ROWS[1], chart_room - len(models) - 1)
        chart = [(QUIET, "air (o), reference (-), forecast (.) in °C")]
        chart += [(PLAIN, row) for row in chart_rows(records, height, columns)]
    else:
        models = []
    left = room - len(chart) - len(models)
    lines = [*top, *chart, *models, *shown[-max(0, left) :][:left], *bottom]
    return [(style, _cut(text, columns)) for style, text in lines[:rows]]


def _heading(record: TickRecord) -> list[Line]:
    at = datetime.fromtimestamp(record.utc)
    style = "bold" if record.mode in HEALTHY_MODES else ALARM
    return [(style, f"mode {record.mode}  {at:%H:%M:%S}  tick {record.seq}")]


def _alarms(record: TickRecord) -> Iterator[Line]:
    """Lines for a silent board, a trip, and every command that safety changed."""
    if not record.link_up:
        yield (ALARM, "ALARM  the board is silent: it turns its heater off by itself")
    if record.echo is not None and record.echo.stopped:
        yield (ALARM, f"STOPPED  the board holds everything off: {record.echo.trip_cause}")
    elif record.echo is not None and record.echo.tripped:
        yield (ALARM, f"ALARM  the board has tripped: {record.echo.trip_cause}")
    said = dict.fromkeys(f"safety  {change.reason} ({change.rule})" for change in record.changes)
    yield from (("yellow", text) for text in said)


def _facts(record: TickRecord, columns: int) -> list[Line]:
    air = record.readings.get("temp_air")
    measured = "no reading" if air is None else f"not known ({air.quality.value})"
    if air is not None and air.value is not None:
        measured = f"{air.value:.1f} °C ({air.quality.value})"
    duty = record.sent.heater_duty
    facts = [
        f"air        {measured}",
        f"reference  {record.reference_c:.1f} °C",
        f"heater     {duty:4.2f} [{'#' * round(10 * duty):<10s}]",
        f"fan        {fan_in_words(record.sent.fan)}",
        f"control    {record.decision.controller}, {record.decide_ms:.0f} ms",
        f"room       {record.estimate.temp_ambient:.1f} °C",
    ]
    if columns < TWO_COLUMNS_FROM:
        return [(PLAIN, fact) for fact in facts]
    half = min(columns // 2, TWO_COLUMNS_FROM // 2)
    return [(PLAIN, f"{left:<{half}s}{right}") for left, right in zip(facts[::2], facts[1::2], strict=True)]


def _explanation(record: TickRecord, columns: int) -> Iterator[Line]:
    """Yield the first sentences of the decision's "why" that fit two lines, and a drift of the twin."""
    sentences: list[str] = []
    room = 2 * (columns - len("why        "))
    for sentence in reasons(record.decision.why):
        if sentences and len(" ".join([*sentences, sentence])) > room - 10:
            break
        sentences.append(sentence)
    if sentences:
        wrapped = textwrap.wrap(" ".join(sentences), max(20, columns - 11), max_lines=2, placeholder=" ...")
        yield from ((PLAIN, f"{'why' if i == 0 else '':<11s}{text}") for i, text in enumerate(wrapped))
    if record.drift is not None and record.drift.state.value == "disagrees":
        yield ("yellow", f"twin       {record.drift.text}")


def _event(event: Event) -> Line:
    style = PLAIN if event.severity is Severity.INFO else ALARM
    return style, f"{datetime.fromtimestamp(event.utc):%H:%M:%S} {event.text}"


def _cut(text: str, columns: int) -> str:
    text = " ".join(text.split("\n"))
    return text if len(text) <= columns else text[: max(0, columns - 1)] + "…"


def forecast_facts(record: TickRecord) -> list[tuple[str, str]]:
    """Return a row per model: its forecast for MODELS_MIN and its recent mean error."""
    errors = {
        skill.predictor: f"off by {skill.mae_k:.2f} K lately"
        for skill in record.skill
        if skill.horizon_min == MODELS_MIN
    }
    facts = []
    for name, forecast in record.forecasts.items():
        temp, width = forecast.temps.get(MODELS_MIN), forecast.half_widths.get(MODELS_MIN)
        if temp is not None:
            interval = "" if width is None else f" ± {width:.2f} (90 %)"
            words = (
                f"{temp:.1f}{interval} °C",
                errors.get(name, ""),
                "untrained there" * bool(forecast.outside),
            )
            facts.append((f"{name} in {MODELS_MIN} min", ", ".join(filter(None, words))))
    return facts


def chart_rows(records: Sequence[TickRecord], rows: int, columns: int) -> list[str]:
    """Temperatures of the last ticks and of the plan, as `rows` rows of characters, hottest first."""
    width = columns - LABEL_COLUMNS
    ahead = width // FORECAST_SHARE
    records = records[-(width - ahead) :]
    forecast = list(records[-1].decision.forecast)[:ahead]
    air = [record.estimate.temp_air for record in records]
    reference = [record.reference_c for record in records]
    values = [value for value in air + reference + forecast if value == value]
    if not values:
        return ["no air temperature yet"]
    low, high = min(values) - 0.2, max(values) + 0.2
    grid = [[" "] * width for _ in range(rows)]
    now = width - ahead
    for mark, start, series in (
        ("-", now - len(records), reference),
        (".", now, forecast),
        ("o", now - len(records), air),
    ):
        for column, value in enumerate(series, start=start):
            if value == value:
                grid[round((high - value) / (high - low) * (rows - 1))][column] = mark
    step = (high - low) / (rows - 1)
    return [f"{high - row * step:5.1f} {''.join(cells)}" for row, cells in enumerate(grid)]


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
        f"  heater {tick['sent']['heater_duty']:4.2f}  fan {fan_in_words(tick['sent']['fan_share']):<4s}"
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
