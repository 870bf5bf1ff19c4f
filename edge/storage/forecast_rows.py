"""Forecasts and their skill as rows, and forecasts back.

Temperatures and half widths are JSON arrays over HORIZONS_MIN, null where there is none: 4 predictors at 1440
ticks a day are half a megabyte, a row per number would be 3.
"""

import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from edge.core.horizons import HORIZONS_MIN
from edge.core.messages import Forecast, TickRecord
from edge.formats.tick_json import TEMP_DIGITS, WIDTH_DIGITS, number

HOUR_S = 3600
_SKILL = "INSERT OR REPLACE INTO skill VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


def insert_forecasts(connection: sqlite3.Connection, records: Sequence[TickRecord]) -> None:
    """Insert the records' forecasts, in the transaction that the caller holds."""
    connection.executemany(
        "INSERT INTO forecasts VALUES (?, ?, ?, ?, ?, ?)",
        [
            (
                *(r.seq, name, _json(f.temps, TEMP_DIGITS), _json(f.half_widths, WIDTH_DIGITS)),
                *(None if f.outside is None else int(f.outside), f.reason),
            )
            for r in records
            for name, f in r.forecasts.items()
        ],
    )


def keep_skill(connection: sqlite3.Connection, records: Sequence[TickRecord]) -> None:
    """Let each hour's rows be the skill after its last tick, in the transaction that the caller holds."""
    last_of_hour = {int(r.utc // HOUR_S) * HOUR_S: r for r in records if r.skill}
    connection.executemany(
        _SKILL,
        [
            (
                *(hour_utc, s.predictor, s.horizon_min, s.version, s.scored, number(s.mae_k)),
                *(number(s.against_persistence), number(s.against_pbm)),
                *(number(s.half_width_k), number(s.covered)),
            )
            for hour_utc, record in last_of_hour.items()
            for s in record.skill
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


def _json(values: Mapping[int, float], digits: int) -> str:
    row = [number(values.get(minutes), digits) for minutes in HORIZONS_MIN] if values else []
    return json.dumps(row, separators=(",", ":"))


def _horizons(text: str) -> dict[int, float]:
    row = json.loads(text)
    return {minutes: value for minutes, value in zip(HORIZONS_MIN, row, strict=False) if value is not None}
