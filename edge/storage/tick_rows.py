"""A TickRecord with its forecasts and their skill as rows, and back.

Temperatures and half widths are JSON arrays over HORIZONS_MIN, null where there is none: 4 predictors at 1440
ticks a day are half a megabyte, a row per number would be 3.
"""

import json
import math
import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from edge.core.horizons import HORIZONS_MIN
from edge.core.messages import (
    Change,
    Command,
    Decision,
    Echo,
    Estimate,
    Event,
    Forecast,
    Reading,
    ReadingQuality,
    Severity,
    TickRecord,
)
from edge.core.names import SIGNALS
from edge.formats.tick_json import TEMP_DIGITS, WIDTH_DIGITS, json_value, number

HOUR_S = 3600
_SKILL = "INSERT OR IGNORE INTO skill VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


def insert_forecasts(connection: sqlite3.Connection, records: Sequence[TickRecord]) -> None:
    """Insert the records' forecasts, in the transaction that the caller holds."""
    connection.executemany(
        "INSERT INTO forecasts VALUES (?, ?, ?, ?, ?, ?)",
        [
            (
                *(
                    r.seq,
                    name,
                    _forecast_json(f.temps, TEMP_DIGITS),
                    _forecast_json(f.half_widths, WIDTH_DIGITS),
                ),
                *(None if f.outside is None else int(f.outside), f.reason),
            )
            for r in records
            for name, f in r.forecasts.items()
        ],
    )


def keep_skill(connection: sqlite3.Connection, records: Sequence[TickRecord]) -> None:
    """Let each hour's rows be the skill at its first tick, in the transaction that the caller holds.

    Rows that change with each tick would be a fifth of what the daemon writes to its card.
    """
    connection.executemany(
        _SKILL,
        [
            (
                *(hour_utc, s.predictor, s.horizon_min, s.version, s.scored, number(s.mae_k)),
                *(number(s.against_persistence), number(s.against_pbm)),
                *(number(s.half_width_k), number(s.covered)),
            )
            for hour_utc, skill in ((int(r.utc // HOUR_S) * HOUR_S, r.skill) for r in records)
            for s in skill
        ],
    )


def read_forecasts(connection: sqlite3.Connection, seqs: Iterable[int]) -> dict[int, dict[str, Forecast]]:
    """By tick and predictor; ticks without any are not there."""
    found: defaultdict[int, dict[str, Forecast]] = defaultdict(dict)
    rows = connection.execute(
        "SELECT seq, predictor, temp_c, half_width_k, outside, reason FROM forecasts"
        " WHERE seq IN (SELECT value FROM json_each(?)) ORDER BY 1, 2",
        (json.dumps(list(seqs)),),
    )
    for seq, predictor, temps, half_widths, outside, reason in rows:
        flag = None if outside is None else bool(outside)
        found[seq][predictor] = Forecast(_horizons(temps), _horizons(half_widths), flag, reason)
    return found


def _forecast_json(values: Mapping[int, float], digits: int) -> str:
    row = [number(values.get(minutes), digits) for minutes in HORIZONS_MIN] if values else []
    return json.dumps(row, separators=(",", ":"))


def _horizons(text: str) -> dict[int, float]:
    row = json.loads(text)
    return {minutes: value for minutes, value in zip(HORIZONS_MIN, row, strict=False) if value is not None}


_COMMAND_COLUMNS = ("heater_duty", "fan_on", "led", "valve_pulse_s")
TICK_COLUMNS = (
    *("seq", "session", "utc", "step_s", "mode", "controller", "reference_c"),
    *("estimate_temp_air_c", "estimate_sd_k", "estimate_offset_k_per_step", "innovation_k"),
    "estimate_temp_ambient_c",
    *(f"wanted_{name}" for name in _COMMAND_COLUMNS),
    *(f"sent_{name}" for name in _COMMAND_COLUMNS),
    *("echo_heater_duty", "echo_fan_on", "echo_led", "echo_valve_open", "echo_tripped", "echo_trip_cause"),
    *("link_up", "ticks_skipped", "late_s", "decide_ms", "time_s"),
)
_INSERT_TICK = f"INSERT INTO ticks ({', '.join(TICK_COLUMNS)}) VALUES ({', '.join('?' * len(TICK_COLUMNS))})"
_SIGNAL_OF_KEY = {signal.key: name for name, signal in SIGNALS.items()}
NAN = math.nan


def insert_ticks(connection: sqlite3.Connection, records: Sequence[TickRecord], session: int) -> None:
    """Insert the records and queue them for telemetry, in the transaction that the caller holds."""
    connection.executemany(_INSERT_TICK, [_tick_row(record, session) for record in records])
    connection.executemany(
        "INSERT INTO readings VALUES (?, ?, ?, ?)",
        [
            (record.seq, SIGNALS[name].key, _finite(reading.value), reading.quality.value)
            for record in records
            for name, reading in record.readings.items()
        ],
    )
    connection.executemany(
        "INSERT INTO decisions VALUES (?, ?, ?)",
        [(r.seq, _json([number(t) for t in r.decision.forecast]), _json(r.decision.why)) for r in records],
    )
    insert_forecasts(connection, records)
    keep_skill(connection, records)
    connection.executemany(
        "INSERT INTO changes VALUES (?, ?, ?, ?, ?, ?, ?)",
        [
            (record.seq, i, c.rule, c.actuator, _finite(c.wanted), _finite(c.sent), c.reason)
            for record in records
            for i, c in enumerate(record.changes)
        ],
    )
    connection.executemany(
        "INSERT INTO events VALUES (?, ?, ?, ?, ?, ?)",
        [
            (record.seq, i, _finite(e.utc), e.key, e.severity.value, e.text)
            for record in records
            for i, e in enumerate(record.events)
        ],
    )
    # In the same transaction: what is stored is published, even after a kill between the two.
    connection.executemany(
        "INSERT INTO outbox (seq, event, is_resend) VALUES (?, ?, 0)",
        [(r.seq, event) for r in records for event in (*range(len(r.events)), None)],
    )


def read_ticks(connection: sqlite3.Connection, seqs: Iterable[int]) -> dict[int, TickRecord]:
    """Return the stored ticks with these numbers, without missing or damaged ones.

    Monotonic times come back as NaN: they mean nothing after their process.
    """
    numbers = list(seqs)
    try:
        return _read(connection, numbers)
    except (ValueError, TypeError, KeyError, RecursionError):
        pass
    except sqlite3.OperationalError as error:
        if "decode" not in str(error):
            raise
    if len(numbers) == 1:
        return {}
    return {seq: record for number in numbers for seq, record in read_ticks(connection, [number]).items()}


def _read(connection: sqlite3.Connection, numbers: list[int]) -> dict[int, TickRecord]:
    chosen = json.dumps(numbers)

    def rows(columns: str, table: str) -> list[tuple[Any, ...]]:
        query = f"SELECT {columns} FROM {table} WHERE seq IN (SELECT value FROM json_each(?)) ORDER BY 1, 2"
        return connection.execute(query, (chosen,)).fetchall()

    readings: defaultdict[int, dict[str, Reading]] = defaultdict(dict)
    # One query a table for all ticks, not one for each tick: a resend may ask for a day of them.
    for seq, key, value, quality in rows("seq, signal, value, quality", "readings"):
        readings[seq][_SIGNAL_OF_KEY[key]] = Reading(
            _SIGNAL_OF_KEY[key], None if value is None else float(value), NAN, ReadingQuality(quality)
        )
    changes: defaultdict[int, list[Change]] = defaultdict(list)
    for seq, _, rule, actuator, wanted, sent, reason in rows("*", "changes"):
        changes[seq].append(Change(rule, actuator, _or_nan(wanted), _or_nan(sent), reason))
    events: defaultdict[int, list[Event]] = defaultdict(list)
    for seq, _, utc, key, severity, text in rows("*", "events"):
        events[seq].append(Event(key, Severity(severity), text, NAN, _or_nan(utc)))
    forecasts = read_forecasts(connection, numbers)
    decisions = {seq: (forecast, why) for seq, forecast, why in rows("*", "decisions")}
    return {
        row[0]: _record(
            row,
            readings[row[0]],
            decisions.get(row[0]),
            tuple(changes[row[0]]),
            tuple(events[row[0]]),
            forecasts.get(row[0], {}),
        )
        for row in rows(", ".join(TICK_COLUMNS), "ticks")
    }


def _tick_row(record: TickRecord, session: int) -> tuple[Any, ...]:
    estimate, echo = record.estimate, record.echo
    return (
        record.seq,
        session,
        record.utc,
        record.step_s,
        record.mode,
        record.decision.controller,
        _finite(record.reference_c),
        _finite(estimate.temp_air),
        _finite(estimate.temp_air_sd),
        _finite(estimate.offset),
        _finite(estimate.innovation),
        _finite(estimate.temp_ambient),
        *_command_row(record.wanted),
        *_command_row(record.sent),
        *((None,) * 6 if echo is None else _echo_row(echo)),
        int(record.link_up),
        record.ticks_skipped,
        _finite(record.late_s),
        _finite(record.decide_ms),
        _finite(record.time_s),
    )


def _command_row(command: Command) -> tuple[float | None, ...]:
    return (
        _finite(command.heater_duty),
        command.fan,
        _finite(command.led),
        _finite(command.valve_pulse_s),
    )


def _echo_row(echo: Echo) -> tuple[Any, ...]:
    return (
        _finite(echo.heater_duty),
        echo.fan,
        _finite(echo.led),
        int(echo.valve_open),
        int(echo.tripped),
        echo.trip_cause,
    )


def _record(
    row: tuple[Any, ...],
    readings: dict[str, Reading],
    decision: tuple[str, str] | None,
    changes: tuple[Change, ...],
    events: tuple[Event, ...],
    forecasts: dict[str, Forecast],
) -> TickRecord:
    """One record from its row of `ticks` (columns as in TICK_COLUMNS) and its rows of the other tables."""
    forecast, why = ("[]", "{}") if decision is None else decision
    wanted, sent = _command(row[12:16]), _command(row[16:20])
    return TickRecord(
        seq=row[0],
        time_s=NAN,
        utc=float(row[2]),
        step_s=float(row[3]),
        mode=row[4],
        readings=readings,
        estimate=Estimate(
            _or_nan(row[7]),
            _or_nan(row[8]),
            _or_nan(row[9]),
            None if row[10] is None else float(row[10]),
            _or_nan(row[11]),
            time_s=NAN,
        ),
        reference_c=_or_nan(row[6]),
        decision=Decision(wanted, row[5], tuple(_or_nan(t) for t in json.loads(forecast)), json.loads(why)),
        wanted=wanted,
        changes=changes,
        sent=sent,
        # Every echo has a trip cause, "" at least.
        echo=None if row[25] is None else _echo(row[20:26]),
        link_up=bool(row[26]),
        events=events,
        ticks_skipped=int(row[27]),
        late_s=_or_nan(row[28]),
        decide_ms=_or_nan(row[29]),
        forecasts=forecasts,
    )


def _command(row: tuple[Any, ...]) -> Command:
    return Command(_or_nan(row[0]), bool(row[1]), _or_nan(row[2]), _or_nan(row[3]), fan_share=row[1] or 1.0)


def _echo(row: tuple[Any, ...]) -> Echo:
    duty, fan, led, valve_open, tripped, cause = row
    on = bool(fan)
    return Echo(_or_nan(duty), on, _or_nan(led), bool(valve_open), bool(tripped), cause, NAN, fan or 1.0)


def _json(value: Any) -> str:
    return json.dumps(json_value(value), separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return NAN if value is None else float(value)
