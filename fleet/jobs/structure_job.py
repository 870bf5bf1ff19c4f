"""Fits of a night: boxes of a kind in what they have told, alone and joined, from their numbers in store.

A box is fitted once it has run for a day, and again when it has told another twin. Of a kind with many boxes
some tell enough.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.core.errors import GreenhouseError
from edge.core.sweep import sweep
from edge.twin.twin_file import twin_document, twin_of
from fleet.database.rigs import FleetRig
from fleet.database.structures import StructureFit
from fleet.jobs.diagnosis_job import begun_disagreements
from fleet.jobs.rig_run import runs_to_fit
from fleet.jobs.told_sheets import ToldSheets, told_sheets
from fleet.priors.kind_structure import Fits, Structure, fit_structure, structures
from fleet.settings import NumbersSettings

DAY_S, WEEK_S = 86_400.0, 7 * 86_400.0
MOST_BOXES = 30  # of a kind; a box takes half a minute of a core for each structure


@dataclass(frozen=True, slots=True)
class FitJob:
    """A box to fit. twin : that it has told; until_utc : now [s since 1970]"""

    rig: str
    twin: Mapping[str, Any]
    structure: Structure
    numbers: NumbersSettings
    until_utc: float


def fit_structures(
    engine: Engine, numbers: NumbersSettings, utc: float, workers: int = 1, dask: str | None = None
) -> tuple[int, int]:
    """Fit what is not fitted yet and keep it.

    Returns : number of new fits, and of those that could not be made
    Errors : SweepError
    """
    told = told_sheets(engine)
    new = failed = 0
    for jobs in _jobs(engine, told, numbers, utc):  # kept kind by kind, as a night may end in between
        found = sweep(carry_out, jobs, workers, dask)
        with Session(engine) as session, session.begin():
            for job, document in zip(jobs, found, strict=True):
                if document is not None:
                    own = StructureFit(
                        rig=job.rig, structure=text_of(job.structure), utc=utc, document=document
                    )
                    own.told_sha256 = told.sha256[job.rig]
                    session.merge(own)
        new += sum(document is not None for document in found)
        failed += sum(document is None for document in found)
    return new, failed


def carry_out(job: FitJob) -> dict[str, Any] | None:
    """Fit one box; None where that cannot be done, which ends no other's and is tried again another night."""
    try:
        file = twin_of(job.twin)
        runs = runs_to_fit(job.numbers, job.rig, file, job.until_utc - WEEK_S, job.until_utc)
        return twin_document(fit_structure(file, runs, job.structure))
    except GreenhouseError:
        return None


def known_fits(engine: Engine, told: ToldSheets) -> Fits:
    """Return the fits of boxes that have told no other twin since."""
    with Session(engine) as session:
        return {
            (one.rig, structure_of(one.structure)): twin_of(one.document)
            for one in session.scalars(select(StructureFit))
            if told.sha256.get(one.rig) == one.told_sha256
        }


def _jobs(engine: Engine, told: ToldSheets, numbers: NumbersSettings, utc: float) -> Iterator[list[FitJob]]:
    """Yield what is to be done of each kind."""
    with Session(engine) as session:
        known = session.execute(select(StructureFit.rig, StructureFit.structure, StructureFit.told_sha256))
        done = {(rig, structure_of(text), sha256) for rig, text, sha256 in known}
        have_run = set(session.scalars(select(FleetRig.name).where(FleetRig.first_utc <= utc - DAY_S)))
        have_run -= begun_disagreements(session).keys()  # they are no longer what they were
    for kind, wanted in structures(told.sheets).items():
        boxes = [sheet for sheet in told.sheets if sheet.kind == kind and sheet.rig in have_run][:MOST_BOXES]
        jobs = [
            FitJob(sheet.rig, twin_document(sheet.twin), structure, numbers, utc)
            for sheet in boxes
            for structure in wanted
            if (sheet.rig, structure, told.sha256[sheet.rig]) not in done
        ]
        if len(boxes) > 1 and jobs:
            yield jobs


def text_of(structure: Structure) -> str:
    """Return a structure as the database has it."""
    return "+".join(structure)


def structure_of(text: str) -> Structure:
    """Return the structure of a text in the database."""
    return tuple(name for name in text.split("+") if name)
