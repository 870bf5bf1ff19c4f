"""Rehearsals of a night: some boxes of each kind as if they were new, by what the others of it have told."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.core.errors import GreenhouseError
from edge.core.sweep import sweep
from edge.twin.twin_file import twin_document, twin_of
from fleet.database.structures import BoxRehearsal
from fleet.jobs.rig_run import rig_run
from fleet.jobs.structure_job import WEEK_S, known_fits, structure_of, text_of
from fleet.jobs.told_sheets import ToldSheets, told_sheets
from fleet.numbers.victoria import Numbers
from fleet.priors.kind_structure import Rehearsals, Structure, comparable, structures
from fleet.priors.rehearsal import Rehearsal, rehearse
from fleet.settings import NumbersSettings

MOST_BOXES = 6  # of a kind; with a day in store a box takes 2 to 6 s of a core for each structure


@dataclass(frozen=True, slots=True)
class RehearsalJob:
    """A box to rehearse.

    twin : that it has told; others : of its kind, by structure; told_sha256 : of what all of them have told
    until_utc : now [s since 1970]
    """

    rig: str
    twin: Mapping[str, Any]
    others: Mapping[Structure, Sequence[Mapping[str, Any]]]
    told_sha256: str
    numbers: NumbersSettings
    until_utc: float


def rehearse_kinds(
    engine: Engine, numbers: NumbersSettings, utc: float, workers: int = 1, dask: str | None = None
) -> tuple[int, int]:
    """Rehearse the kinds of which a box has told or was fitted since, and keep what comes out.

    Returns : number of boxes, and of those that could not be rehearsed
    Errors : SweepError
    """
    done = failed = 0
    for jobs in _jobs(engine, told_sheets(engine), numbers, utc):
        found = sweep(carry_out, jobs, workers, dask)
        with Session(engine) as session, session.begin():
            for job, missed in zip(jobs, found, strict=True):
                for structure, own in (missed or {}).items():
                    row = BoxRehearsal(rig=job.rig, structure=text_of(structure), utc=utc)
                    row.told_sha256 = job.told_sha256
                    row.missed_k, row.loss_share = own.missed_k, own.loss_share
                    session.merge(row)
        done += sum(missed is not None for missed in found)
        failed += sum(missed is None for missed in found)
    return done, failed


def carry_out(job: RehearsalJob) -> dict[Structure, Rehearsal] | None:
    """Rehearse one box; None where that cannot be done, which ends no other's and is tried another night."""
    try:
        run = rig_run(Numbers(job.numbers), job.rig, job.until_utc - WEEK_S, job.until_utc)
        return {
            structure: rehearse(twin_of(job.twin), [run], [twin_of(other) for other in others])
            for structure, others in job.others.items()
        }
    except GreenhouseError:
        return None


def known_rehearsals(engine: Engine, told: ToldSheets) -> Rehearsals:
    """Return what is kept of the boxes, the last word of each in each structure."""
    rigs = {sheet.rig for sheet in told.sheets}
    with Session(engine) as session:
        return {
            (one.rig, structure_of(one.structure)): Rehearsal(one.missed_k, one.loss_share)
            for one in session.scalars(select(BoxRehearsal))
            if one.rig in rigs
        }


def _jobs(
    engine: Engine, told: ToldSheets, numbers: NumbersSettings, utc: float
) -> Iterator[list[RehearsalJob]]:
    """Yield what is to be done of each kind."""
    fits = known_fits(engine, told)
    twins = {sheet.rig: sheet.twin for sheet in told.sheets}
    with Session(engine) as session:
        known = session.execute(select(BoxRehearsal.rig, BoxRehearsal.structure, BoxRehearsal.told_sha256))
        done = {(rig, structure_of(text), sha256) for rig, text, sha256 in known}
    for kind, wanted in structures(told.sheets).items():
        rigs = [sheet.rig for sheet in told.sheets if sheet.kind == kind]
        names, fitted = comparable(wanted, rigs, fits)
        if len(fitted) < 2:  # nobody tells it anything
            continue
        sha256 = _sha256({rig: told.sha256[rig] for rig in fitted})
        jobs = [
            RehearsalJob(
                rig,
                twin_document(twins[rig]),
                {
                    own: [twin_document(fits[other, own]) for other in fitted if other != rig]
                    for own in names
                    if (rig, own, sha256) not in done
                },
                sha256,
                numbers,
                utc,
            )
            for rig in fitted[:MOST_BOXES]
        ]
        if jobs := [job for job in jobs if job.others]:
            yield jobs


def _sha256(told: Mapping[str, str]) -> str:
    return hashlib.sha256("\n".join(f"{rig} {told[rig]}" for rig in sorted(told)).encode()).hexdigest()
