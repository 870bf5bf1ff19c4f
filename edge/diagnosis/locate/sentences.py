"""Sentences about the located disagreement."""

from collections.abc import Sequence
from math import floor, log10

from edge.diagnosis.locate.regimes import DisagreementRegime
from edge.diagnosis.locate.stretches import Stretch

CLEAR = 2.0  # standard errors from 0 that a heat must be before it is given a direction


def regime_sentence(regime: DisagreementRegime) -> str:
    """Such as `71 % of the squared error lies where the fan is off; there the model gains 38 ± 3 W too much`.

    The share of the rows stands beside that of the error.
    """
    share = f"{percent(regime.share_of_squared_error)} of the squared error lies {_where(regime.where)}"
    rows = f"({percent(regime.share_of_rows)} of the rows)"
    if abs(regime.heat_w) < CLEAR * regime.heat_w_se:
        heat = (
            f"the residual heat averages {with_error(regime.heat_w, regime.heat_w_se)} W: no clear direction"
        )
        return f"{share} {rows}; there {heat}"
    direction = "too much" if regime.heat_w < 0.0 else "too little"
    heat = with_error(abs(regime.heat_w), regime.heat_w_se)
    return f"{share} {rows}; there the model gains {heat} W {direction}"


def stretch_sentence(stretch: Stretch) -> str:
    """Such as `19 % of the squared error lies in run_3 from 30 to 55 min, where it is 2.1 K`."""
    begin, end = stretch.from_s / 60.0, stretch.to_s / 60.0
    return (
        f"{percent(stretch.share)} of the squared error lies in {stretch.run} "
        f"from {begin:.0f} to {end:.0f} min, where the free run is off by {stretch.rmse_k:.2g} K"
    )


def findings(regimes: Sequence[DisagreementRegime], stretches: Sequence[Stretch]) -> list[str]:
    """All sentences, strongest first; one that says so where nothing stands out."""
    told = [regime_sentence(item) for item in regimes] + [stretch_sentence(item) for item in stretches]
    return told or ["The squared error is spread evenly: no regime and no time has more than its share"]


def percent(share: float) -> str:
    """In whole percent, but neither 0 nor 100 where it is not."""
    if 0.0 < share < 0.005:
        return "less than 1 %"
    if 0.995 < share < 1.0:
        return "more than 99 %"
    return f"{100.0 * share:.0f} %"


def with_error(value: float, error: float) -> str:
    """`38 ± 3`: the error to one digit (two if it begins with 1), the value as far as that."""
    if not error > 0.0:
        return f"{value:.3g}"
    place = floor(log10(error))
    if round(error / 10.0**place, 1) < 2.0:
        place -= 1
    elif round(error / 10.0**place) == 10:
        place += 1
    digits = max(0, -place)
    return f"{round(value, -place):.{digits}f} ± {round(error, -place):.{digits}f}"


def _where(where: str) -> str:
    return where if where.startswith(("in ", "on ", "between ", "from ")) else f"where {where}"
