"""Runs in the booted machine as root: a rig's ticks by its history, VictoriaMetrics and SQL, as JSON."""

import json
import sqlite3
import sys
import urllib.parse
import urllib.request
from contextlib import closing

HISTORY, FLEET = "/var/lib/greenhouse/history.db", "/var/lib/greenhouse-fleet/fleet.db"
NUMBERS = "http://127.0.0.1:8430/api/v1/export?"


def rows(path: str, sql: str, *values: str) -> list:
    """Return the rows of a query, without writing anything."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=20.0)) as database:
        return database.execute(sql, values).fetchall()


def samples(rig: str) -> list:
    """Return number and time [ms] of each tick in VictoriaMetrics."""
    query = urllib.parse.urlencode({"match[]": f'greenhouse_seq{{rig="{rig}"}}'})
    with urllib.request.urlopen(NUMBERS + query, timeout=20.0) as answer:
        found = [json.loads(line) for line in answer]
    return [
        [int(value), stamp]
        for series in found
        for value, stamp in zip(series["values"], series["timestamps"], strict=True)
    ]


rig = sys.argv[1]
own = [[seq, round(1e3 * utc)] for seq, utc in rows(HISTORY, "SELECT seq, utc FROM ticks ORDER BY seq")]
spans = rows(FLEET, "SELECT first_seq, last_seq FROM stored_spans WHERE rig = ? ORDER BY first_seq", rig)
print(json.dumps({"own": own, "numbers": samples(rig), "spans": spans}))
