"""The errors of two bundles on the same ticks, as a trial reads them."""

from collections.abc import Mapping

from edge.bundle.trial import HorizonScore
from edge.core.predictor import Predictor
from edge.forecasts.skill import RIVAL, SkillState


def rival_rows(
    state: SkillState, active: Mapping[str, Predictor], rivals: Mapping[str, Predictor]
) -> tuple[HorizonScore, ...]:
    """Return a row per horizon and model of both bundles, in their present
    versions, the shortest horizon first.
    """
    rows = []
    for (name, horizon, reference), pair in sorted(state.pairs.items(), key=lambda item: item[0][1]):
        if name != reference + RIVAL or reference not in active or reference not in rivals:
            continue
        if pair.versions == (rivals[reference].version, active[reference].version):
            rows.append(
                HorizonScore(reference, 60.0 * horizon, pair.scored, pair.reference_mae_k, pair.mae_k)
            )
    return tuple(rows)
