"""The prior renewed: every told twin goes in, a prior and the boxes that are unlike their kind come out."""

from dataclasses import dataclass

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from edge.formats.reader import read
from fleet.database.twins import Departure, KeptPrior
from fleet.jobs.rehearsal_job import known_rehearsals
from fleet.jobs.structure_job import known_fits
from fleet.jobs.told_sheets import told_sheets
from fleet.priors.fleet_prior import FleetPrior, fit_prior
from fleet.priors.kind_structure import choose, in_kind_structure, loss_shares
from fleet.priors.prior_document import PriorDocument, document_of, prior_of

KEPT = 30  # priors


@dataclass(frozen=True, slots=True)
class RenewedPrior:
    """Counts of a renewal. unread : rigs whose twin cannot be read, with the reason"""

    boxes: int
    departures: int
    unread: dict[str, str]


def renew_prior(engine: Engine, utc: float) -> RenewedPrior:
    """Fit the prior anew and keep it. Errors: DataError where no rig has told a twin"""
    told = told_sheets(engine)
    fits = known_fits(engine, told)
    rehearsed = known_rehearsals(engine, told)
    chosen = choose(told.sheets, fits, rehearsed)
    shared = in_kind_structure(told.sheets, fits, chosen)
    prior = fit_prior(shared, loss_shares(told.sheets, chosen, rehearsed))
    every = {sheet.rig: sheet for sheet in (*told.sheets, *shared)}
    far = [(rig, one) for rig, sheet in every.items() for one in prior.far_values(sheet)]
    with Session(engine) as session, session.begin():
        session.add(KeptPrior(utc=utc, boxes=len(every), document=document_of(prior)))
        older = select(KeptPrior.utc).order_by(KeptPrior.utc.desc()).offset(KEPT)
        session.execute(delete(KeptPrior).where(KeptPrior.utc.in_(session.scalars(older).all())))
        known = {(one.rig, one.effect, one.parameter): one for one in session.scalars(select(Departure))}
        for rig, one in far:
            row = known.pop((rig, one.effect, one.parameter), None)
            if row is None:
                row = Departure(rig=rig, effect=one.effect, parameter=one.parameter, since_utc=utc)
                session.add(row)
            row.ratio, row.spreads = one.ratio, one.spreads
        for row in known.values():  # it is like its kind again
            session.delete(row)
    return RenewedPrior(len(every), len(far), told.unread)


def newest_prior(engine: Engine) -> FleetPrior:
    """Return the prior that was kept last. Errors: DataError where there is none"""
    with Session(engine) as session:
        kept = session.scalars(select(KeptPrior).order_by(KeptPrior.utc.desc()).limit(1)).first()
    if kept is None:
        raise DataError("no prior yet: `greenhouse fleet work` makes one of the twins that rigs told")
    return prior_of(read(PriorDocument, kept.document))
