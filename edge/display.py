"""What happens, live: a line per tick, or on a terminal a page that redraws itself (rich, imported late)."""

from collections import deque
from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any, TextIO

from edge.messages import TickRecord
from edge.tick_json import tick_json

if TYPE_CHECKING:
    from rich.console import RenderableType

TICKS_SHOWN = 72
CHART_ROWS = 14
EVENTS_SHOWN = 6
MODELS_MIN = 15  # horizon of the models' forecasts that are shown


def tick_line(tick: Mapping[str, Any]) -> str:
    """One tick, in the form of `edge.tick_json`, on one line."""
    air = tick["readings"].get("temp_air_c", {"value": None, "quality": "absent"})
    shown = f"{air['value']:5.1f}" if air["value"] is not None else f"({air['quality']})"
    rules = ",".join(dict.fromkeys(change["rule"] for change in tick["changes"])) or "-"
    forecast = " ".join(f"{value:.1f}" for value in tick["forecast_c"][:3]) or "-"
    events = "".join(f"  ! {event['text']}" for event in tick["events"])
    return (
        f"{_clock(tick['utc'])}  tick {tick['seq']:<5d} air {shown} degC  ref {tick['reference_c']:4.1f}"
        f"  heater {tick['sent']['heater_duty']:4.2f}  fan {'on ' if tick['sent']['fan_on'] else 'off'}"
        f"  {tick['controller']:<7s} forecast {forecast}{_models(tick['forecasts'])}  safety {rules}"
        f"{events}"
    )


def _models(forecasts: Mapping[str, Any]) -> str:
    """What each model expects in MODELS_MIN, "" where none does."""
    expected = {
        name: forecast["temp_c"][str(MODELS_MIN)]
        for name, forecast in forecasts.items()
        if str(MODELS_MIN) in forecast["temp_c"]
    }
    if not expected:
        return ""
    return f"  in {MODELS_MIN} min " + " ".join(f"{name} {temp:.1f}" for name, temp in expected.items())


class LineDisplay:
    """For logs and pipes."""

    def __init__(self, out: TextIO) -> None:
        self._out = out

    def show(self, record: TickRecord) -> None:
        """Print the tick at once."""
        print(tick_line(tick_json(record)), file=self._out, flush=True)

    def close(self) -> None:
        """Nothing to give back."""


class PageDisplay:
    """For terminals: chart, facts, events. Draws in rich's own thread, never in the loop's."""

    def __init__(self) -> None:
        from rich.live import Live

        self._records: deque[TickRecord] = deque(maxlen=TICKS_SHOWN)
        self._events: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._live = Live(get_renderable=self._page, refresh_per_second=8, screen=False)
        self._live.start()

    def show(self, record: TickRecord) -> None:
        """Take the tick; the next redraw shows it."""
        self._records.append(record)
        self._events.extend(f"{_clock(event.utc)} {event.text}" for event in record.events)

    def close(self) -> None:
        """Leave the last page on the screen."""
        self._live.stop()

    def _page(self) -> "RenderableType":
        from rich.console import Group
        from rich.panel import Panel
        from rich.table import Table
        from rich.text import Text

        records = list(self._records)
        if not records:
            return Text("waiting for the first tick ...")
        facts = Table.grid(padding=(0, 2))
        for name, value in _facts(records[-1]):
            facts.add_row(Text(name, style="dim"), Text(value))
        chart = Text("\n".join(chart_rows(records)))
        events = Text("\n".join(self._events) or "no events")
        return Group(
            Panel(chart, title="air temperature (o), reference (-), forecast (.)", border_style="green"),
            Panel(facts, title=f"tick {records[-1].seq}, {_clock(records[-1].utc)}"),
            Panel(events, title="events", border_style="yellow"),
        )


def _facts(record: TickRecord) -> list[tuple[str, str]]:
    air = record.readings.get("temp_air")
    safety = "; ".join(dict.fromkeys(f"{change.rule}: {change.reason}" for change in record.changes))
    bar = "#" * round(20 * record.sent.heater_duty)
    return [
        (
            "air",
            f"{air.value:.1f} degC ({air.quality.value})" if air and air.value is not None else "no reading",
        ),
        ("reference", f"{record.reference_c:.1f} degC"),
        ("room", f"{record.estimate.temp_ambient:.1f} degC"),
        ("heater", f"{record.sent.heater_duty:4.2f} [{bar:<20s}]"),
        ("fan", "on" if record.sent.fan_on else "off"),
        ("controller", f"{record.decision.controller} ({record.mode}), {record.decide_ms:.1f} ms"),
        (
            "why",
            ", ".join(f"{key} {_short(value)}" for key, value in record.decision.why.items() if value)[:200],
        ),
        *forecast_facts(record),
        *([("twin", record.drift.text)] if record.drift else []),
        ("safety", safety or "nothing changed"),
        ("board", "answers" if record.link_up else "silent"),
    ]


def forecast_facts(record: TickRecord) -> list[tuple[str, str]]:
    """A row per model: what it expects in MODELS_MIN, and how far off it was lately."""
    errors = {
        skill.predictor: f"off by {skill.mae_k:.2f} K lately"
        for skill in record.skill
        if skill.horizon_min == MODELS_MIN
    }
    facts = []
    for name, forecast in record.forecasts.items():
        temp, width = forecast.temps.get(MODELS_MIN), forecast.half_widths.get(MODELS_MIN)
        if temp is not None:
            interval = "" if width is None else f" +- {width:.2f} (90 %)"
            words = (
                f"{temp:.1f}{interval} degC",
                errors.get(name, ""),
                "untrained there" * bool(forecast.outside),
            )
            facts.append((f"{name} in {MODELS_MIN} min", ", ".join(filter(None, words))))
    return facts


def chart_rows(records: list[TickRecord]) -> list[str]:
    """Temperatures over the last ticks and the forecast, as rows of characters, hottest first."""
    forecast = list(records[-1].decision.forecast)
    air = [record.estimate.temp_air for record in records]
    reference = [record.reference_c for record in records]
    values = [value for value in air + reference + forecast if value == value]
    if not values:
        return ["no air temperature yet"]
    low, high = min(values) - 0.2, max(values) + 0.2
    width = TICKS_SHOWN + 12
    grid = [[" "] * width for _ in range(CHART_ROWS)]
    first = TICKS_SHOWN - len(records)
    for marks, start, series in (("-", first, reference), (".", TICKS_SHOWN, forecast), ("o", first, air)):
        for column, value in enumerate(series[: width - start], start=start):
            if value == value:
                row = round((high - value) / (high - low) * (CHART_ROWS - 1))
                grid[row][column] = marks
    step = (high - low) / (CHART_ROWS - 1)
    return [f"{high - row * step:5.1f} {''.join(cells)}" for row, cells in enumerate(grid)]


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, dict):
        return "(" + ", ".join(f"{key} {_short(item)}" for key, item in value.items()) + ")"
    return "; ".join(map(str, value)) if isinstance(value, list) else str(value)


def _clock(utc: float) -> str:
    return datetime.fromtimestamp(utc).strftime("%H:%M:%S")


def make_display(out: TextIO) -> LineDisplay | PageDisplay:
    """The page on a terminal, lines anywhere else."""
    return PageDisplay() if out.isatty() else LineDisplay(out)
