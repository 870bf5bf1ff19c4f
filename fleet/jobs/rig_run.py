"""Ticks of a rig in VictoriaMetrics as a run, with the columns of `greenhouse export`, and as runs to fit."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from edge.core.errors import DataError
from edge.core.messages import ReadingQuality
from edge.core.names import SIGNALS
from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import DiagnosisRuns
from edge.formats.run_file import RecordedRun
from edge.twin.twin_file import TwinFile
from fleet.ingest.tick import QUALITIES
from fleet.numbers.series import PREFIX, SEQ, any_of
from fleet.numbers.victoria import Numbers
from fleet.settings import NumbersSettings

INPUTS = {"heater_duty": "echo_heater_duty", "fan_on": "echo_fan_on", "led": "echo_led"}
KEYS = tuple(signal.key for signal in SIGNALS.values())
AIR = SIGNALS["temp_air"].key  # a column of every run
GOOD = QUALITIES[ReadingQuality.GOOD.value]
ROWS_MAX = 6000  # the newest; to diagnose a day takes a minute or two
Samples = dict[float, float]  # utc -> value


def runs_to_fit(
    numbers: NumbersSettings, rig: str, twin: TwinFile, since_utc: float, until_utc: float
) -> DiagnosisRuns:
    """Return the ticks of a rig in this time, the newest part as test runs.

    Errors : DataError where there are none or too few, NumbersError
    """
    run = rig_run(Numbers(numbers), rig, since_utc, until_utc)
    return history_runs([run], twin, source=rig, rows_max=ROWS_MAX)


def rig_run(numbers: Numbers, rig: str, since_utc: float, until_utc: float) -> RecordedRun:
    """Return the ticks of a rig in this time.

    Readings that were not good are missing; an input that the board did not confirm counts as off.
    Errors : DataError where there are none, NumbersError
    """

    wanted = [SEQ, *INPUTS.values(), *(f"{key}{end}" for key in KEYS for end in ("", "_quality"))]
    samples: dict[str, Samples] = {quantity: {} for quantity in wanted}
    for series in numbers.series(any_of(wanted, rig), since_utc, until_utc):
        own = samples[series.labels["__name__"].removeprefix(PREFIX)]
        own.update(zip(series.utc, series.values, strict=True))
    times = sorted(samples[SEQ])
    if not times:
        raise DataError(f"{rig}: no tick from {since_utc:.0f} to {until_utc:.0f} is in store")
    columns = {"time_s": np.round(np.array(times) - times[0], 3)}
    for key in KEYS:
        quality, values = samples[f"{key}_quality"], samples[key]
        column = [values.get(utc, np.nan) if quality.get(utc) == GOOD else np.nan for utc in times]
        if np.isfinite(column).any() or key == AIR:
            columns[key] = np.array(column)
    for name, quantity in INPUTS.items():
        columns[name] = np.array([samples[quantity].get(utc, 0.0) for utc in times])
    start = datetime.fromtimestamp(times[0], UTC).isoformat(timespec="milliseconds")
    return RecordedRun(columns, {"start_utc": start, "rig": rig}, Path(rig))
