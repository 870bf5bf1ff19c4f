"""The prior renewed: every told twin goes in, a prior and the boxes that are unlike their kind come out."""

from dataclasses import dataclass

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from edge.formats.reader import read
from edge.twin.draws import correlations, uncertain
from edge.twin.twin_file import twin_of
from fleet.database.rigs import FleetRig
from fleet.database.twins import Departure, KeptPrior, ToldTwin
from fleet.priors.fleet_prior import BoxSheet, FleetPrior, fit_prior
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
    with Session(engine) as session:
        told = session.execute(select(ToldTwin, FleetRig.kind).join(FleetRig)).all()
    sheets, unread = [], {}
    for twin, kind in told:
        try:
            file = twin_of(twin.document)
            correlations(file, tuple(uncertain(file)))
            sheets.append(BoxSheet(twin.rig, kind, file))
        except DataError as error:
            unread[twin.rig] = str(error)
    prior = fit_prior(sheets)
    far = [(sheet.rig, one) for sheet in sheets for one in prior.far_values(sheet)]
    with Session(engine) as session, session.begin():
        session.add(KeptPrior(utc=utc, boxes=len(sheets), document=document_of(prior)))
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
    return RenewedPrior(len(sheets), len(far), unread)


def newest_prior(engine: Engine) -> FleetPrior:
    """Return the prior that was kept last. Errors: DataError where there is none"""
    with Session(engine) as session:
        kept = session.scalars(select(KeptPrior).order_by(KeptPrior.utc.desc()).limit(1)).first()
    if kept is None:
        raise DataError("no prior yet: `greenhouse fleet work` makes one of the twins that rigs told")
    return prior_of(read(PriorDocument, kept.document))
