"""Diagnoses of a night: each rig whose twin no longer agrees, once since it began to disagree."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.core.errors import DataError, GreenhouseError
from edge.core.messages import ReadingQuality
from edge.core.names import SIGNALS
from edge.core.plain_text import plain
from edge.core.sweep import sweep
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import DiagnosisRuns
from edge.formats.run_file import RecordedRun
from edge.twin.twin_file import TwinFile, twin_of
from fleet.database.tables import RigDiagnosis, RigEvent, ToldTwin
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
DISAGREES, AGREES = "twin.disagrees", "twin.agrees_again"  # keys of a rig's events
BEFORE_S = 7 * 86400.0  # of a run: it must have seen the box that the twin still fitted
FAILED = "failed"


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


@dataclass(frozen=True, slots=True)
class DiagnosisJob:
    """A rig to diagnose. since_utc, until_utc : when it began to disagree, and now [s since 1970]"""

    rig: str
    twin: Mapping[str, Any]
    numbers: NumbersSettings
    since_utc: float
    until_utc: float


@dataclass(frozen=True, slots=True)
class DiagnosisFinding:
    """Result of a job; as `RigDiagnosis`."""

    verdict: str
    text: str
    effects: tuple[str, ...] = ()
    before_k: float | None = None
    after_k: float | None = None


def diagnose_changed(
    engine: Engine, numbers: NumbersSettings, utc: float, workers: int = 1, dask: str | None = None
) -> list[tuple[str, DiagnosisFinding]]:
    """Diagnose every rig that disagrees now and was not diagnosed since it began. Errors: SweepError"""
    jobs = list(_jobs(engine, numbers, utc))
    findings = sweep(carry_out, jobs, workers, dask)
    with Session(engine) as session, session.begin():
        for job, found in zip(jobs, findings, strict=True):
            row = RigDiagnosis(rig=job.rig, since_utc=job.since_utc, utc=utc, verdict=found.verdict)
            row.text, row.effects = found.text, list(found.effects)
            row.before_k, row.after_k = found.before_k, found.after_k
            session.merge(row)
    return [(job.rig, found) for job, found in zip(jobs, findings, strict=True)]


def carry_out(job: DiagnosisJob) -> DiagnosisFinding:
    """Diagnose one rig from what is in store; a rig that cannot be diagnosed ends no other's."""
    try:
        file = twin_of(job.twin)
        runs = runs_to_fit(job.numbers, job.rig, file, job.since_utc - BEFORE_S, job.until_utc)
        found = diagnose(file, runs, lambda text, share: None, "greenhouse fleet work")
    except GreenhouseError as error:
        return DiagnosisFinding(FAILED, f"no diagnosis: {plain(str(error), 400)}")
    names = tuple(effect.name for effect in found.verdict.effects)
    before_k, after_k = (_finite(found.test_k.get(side)) for side in ("before", "after"))
    text = _in_words(found.verdict.kind, names, found.verdict.depends_on)
    return DiagnosisFinding(found.verdict.kind, text, names, before_k, after_k)


def _jobs(engine: Engine, numbers: NumbersSettings, utc: float) -> Iterator[DiagnosisJob]:
    with Session(engine) as session:
        begun = begun_disagreements(session)
        rows = session.execute(select(RigDiagnosis.rig, RigDiagnosis.since_utc))
        done = {(rig, since_utc) for rig, since_utc in rows}
        twins = {twin.rig: twin for twin in session.scalars(select(ToldTwin))}
    for rig, since_utc in begun.items():
        if (rig, since_utc) not in done and rig in twins:
            yield DiagnosisJob(rig, twins[rig].document, numbers, since_utc, utc)


def begun_disagreements(session: Session) -> dict[str, float]:
    """Return the rigs whose twins disagree now, and when the alarm was raised."""
    rows = session.execute(
        select(RigEvent.rig, RigEvent.key, RigEvent.utc)
        .where(RigEvent.key.in_((DISAGREES, AGREES)))
        .order_by(RigEvent.utc, RigEvent.seq, RigEvent.number)
    )
    begun: dict[str, float] = {}
    for rig, key, utc in rows:
        if key == DISAGREES:
            begun[rig] = utc
        else:
            begun.pop(rig, None)
    return begun


def _in_words(kind: str, names: Sequence[str], depends_on: Sequence[str]) -> str:
    if names:
        return f"{', '.join(names)} is missing in its twin"
    if kind == "nothing_missing":
        return "nothing is missing in its twin"
    return f"what is missing has no name; it depends on {', '.join(depends_on) or 'nothing that is known'}"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
