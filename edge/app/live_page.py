"""The live view of a terminal as lines of text: what matters first, as much as the terminal has room for."""

import textwrap
from collections.abc import Iterator, Sequence
from datetime import datetime

from edge.assistant.why.reasons import reasons
from edge.core.messages import Event, Severity, TickRecord
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
        f"fan        {'on' if record.sent.fan_on else 'off'}",
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
