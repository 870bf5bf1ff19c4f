"""Rows of a rollout whose first wave is held, as a runner leaves them; for tests and pictures."""

from collections.abc import Mapping, Sequence

from sqlalchemy.orm import Session

from fleet.database.tables import BundleRollout, FleetBundle, RolloutRig, RolloutWave
from fleet.rollout.states import RigState, RolloutState, WaveState
from fleet.settings import RolloutSettings

DAY_S = 86_400.0
USUAL = RolloutSettings()
WHY = f"not shown to be within {USUAL.margin:.0%}"
UNSURE = {"blocks": 120, "difference": 0.062, "harm": 1.8, "safety": 4.1}
SAFE = {"blocks": 120, "difference": -0.013, "harm": 1.0, "safety": 2.3e4}


def add_held_rollout(
    session: Session,
    utc: float,
    rigs: Mapping[str, str],
    group: str = "",
    version: str = "2.0",
    unsure: Sequence[str] = (),
) -> BundleRollout:
    """Add and return a rollout that began five days before `utc`.

    rigs : kind of each rig of the first wave; the rigs are in the database
    unsure : kinds of which too little is known; the others are shown to be safe
    """
    sha256 = version.encode().hex()[:64].zfill(64)
    bundle = FleetBundle(sha256=sha256, version=version, name="models", created_utc="", archive=b"x")
    bundle.added_utc = utc
    session.merge(bundle)
    session.flush()
    began_utc = utc - 5.2 * DAY_S
    rollout = BundleRollout(
        sha256=sha256,
        version=version,
        group=group,
        state=RolloutState.RUNNING,
        wave=1,
        margin=USUAL.margin,
        error=USUAL.error,
        wave_h=USUAL.wave_h,
        began_utc=began_utc,
    )
    session.add(rollout)
    session.flush()
    kinds = {kind: UNSURE if kind in unsure else SAFE for kind in sorted({*rigs.values()})}
    session.add(
        RolloutWave(
            rollout=rollout.number,
            wave=1,
            state=WaveState.HELD,
            began_utc=began_utc,
            judged_from_utc=began_utc + 3600.0,
            why=f"{WHY}: {', '.join(unsure) or 'every kind'}",
            kinds=kinds,
        )
    )
    session.add_all(
        RolloutRig(
            rollout=rollout.number, rig=rig, kind=kind, wave=1, state=RigState.ACTIVE, since_utc=began_utc
        )
        for rig, kind in rigs.items()
    )
    session.flush()
    return rollout
