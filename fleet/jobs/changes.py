"""Changes of boxes in one list: alarms of twins and diagnoses."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from fleet.database.tables import RigDiagnosis, RigEvent

KEYS = ("twin.disagrees", "twin.agrees_again", "diagnosis.done", "diagnosis.adopted")
Line = tuple[float, str]  # utc, a sentence


def changes(session: Session, since_utc: float) -> dict[str, list[Line]]:
    """Return by rig what was found out since then, in the order of time; the rig with the newest first."""
    found: dict[str, list[Line]] = {}

    def add(rig: str, utc: float, text: str) -> None:
        found.setdefault(rig, []).append((utc, text))

    for event in session.scalars(select(RigEvent).where(RigEvent.key.in_(KEYS), RigEvent.utc >= since_utc)):
        add(event.rig, event.utc, event.text)
    for diagnosis in session.scalars(select(RigDiagnosis).where(RigDiagnosis.utc >= since_utc)):
        add(diagnosis.rig, diagnosis.utc, f"the fleet's diagnosis: {diagnosis.text}{_gap(diagnosis)}")
    newest = sorted(found, key=lambda rig: max(found[rig])[0], reverse=True)
    return {rig: sorted(found[rig]) for rig in newest}


def _gap(diagnosis: RigDiagnosis) -> str:
    if diagnosis.before_k is None or diagnosis.after_k is None:
        return ""
    return f"; its error goes from {diagnosis.before_k:.2f} to {diagnosis.after_k:.2f} K"
