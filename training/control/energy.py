"""MAE at equal energy, energy at equal MAE: every controller beside ours at several weights of effort.

Our controller at several weights gives a curve of energy and MAE. Between two of its runs it is taken as a
line, above the curve itself, which is convex: that speaks against ours.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edge.formats.table import Table
from training.control.comparison import Results, column, seeds_of, spread_text
from training.control.pictures import png
from training.control.rig import SPARING
from training.control.spread import mean_of

Floats = NDArray[np.float64]
OURS = ("MPC-Twin", "MPC-Twin-P", *SPARING)
FAMILIES = {  # beginning of a name -> marker, colour
    "clairvoyant": ("*", "black"), "rules": ("P", "tab:gray"), "PID": ("D", "tab:brown"),
    "MPC-BFGS": ("X", "tab:orange"), "MPC": ("s", "tab:purple"), "RL": ("^", "tab:green"),
    "LLM": (".", "tab:blue"),
}  # fmt: skip
HEADS = ("controller", "Wh", "MAE", "ours at its Wh", "less MAE by", "ours at its MAE [Wh]", "less Wh by")
AIRS = {"the true air": "mae_true", "the sensor": "mae_measured"}  # what a MAE [K] is by
NOTE = (
    f"Ours: {', '.join(OURS)}, seed by seed, a line between neighbours. Beside one that spends "
    "more than all of these, or has a larger MAE, stands the best of ours with less; a dash where ours does "
    "not come down to that energy or MAE."
)


def at_most(limit: float, given: Floats, wanted: Floats) -> float:
    """Least `wanted` on the curve through the points (given, wanted) up to `limit`; nan below all of them."""
    order = np.argsort(given, kind="stable")
    given, least = given[order], np.minimum.accumulate(wanted[order])
    return float(np.interp(limit, given, least)) if limit >= given[0] else float("nan")


def energy_tables(results: Results, names: Sequence[str], reference: str) -> list[Table]:
    """One by each air; none where ours has not run at every weight."""
    found = (energy_table(results, names, reference, air) for air in AIRS)
    return [table for table in found if table is not None]


def energy_table(
    results: Results, names: Sequence[str], reference: str, air: str = "the true air"
) -> Table | None:
    """Return a line per controller; None where ours has not run at every weight.

    air : of AIRS
    """
    rows = []
    for name in names:
        if name in OURS or name.startswith("clairvoyant"):
            continue
        shared = set.intersection(*(seeds_of(results, one, reference) for one in (name, *OURS)))
        if shared:
            on_these = [one for one in results if one.seed in shared]
            points = _points(on_these, name, reference, AIRS[air])
            rows.append(tuple(_cells(name, points, _curves(on_these, reference, AIRS[air]))))
    title = f"{reference}: at equal energy, at equal MAE by {air}"
    return Table(title, HEADS, tuple(rows), NOTE) if rows else None


def energy_picture(results: Results, names: Sequence[str], references: Sequence[str]) -> bytes:
    """Energy and true MAE of every controller, ours as a curve; a panel per reference."""
    figure = Figure(figsize=(6.4 * len(references), 4.6), layout="constrained")
    for axes, reference in zip(
        figure.subplots(1, len(references), squeeze=False)[0], references, strict=True
    ):
        _draw(axes, results, names, reference)
    return png(figure)


def _cells(name: str, points: Floats, ours: Floats) -> Iterator[str]:
    """points : [S, 2], energy and MAE by seed; ours : [S, 2, W], at each weight"""
    energy, mae = points.T
    yield name
    yield spread_text(mean_of(energy.tolist()), 0)
    yield spread_text(mean_of(mae.tolist()), 3)
    for limits, own, given, wanted, digits in ((energy, mae, 0, 1, 3), (mae, energy, 1, 0, 0)):
        found = [at_most(x, curve[given], curve[wanted]) for x, curve in zip(limits, ours, strict=True)]
        yield _spread(found, digits)
        yield _spread(own - np.array(found), digits)


def _spread(values: Sequence[float] | Floats, digits: int) -> str:
    listed = np.asarray(values).tolist()
    return spread_text(mean_of(listed), digits) if np.isfinite(listed).all() else "-"


def _points(results: Results, name: str, reference: str, error: str = "mae_true") -> Floats:
    """[S, 2]"""
    energy, mae = (column(results, name, reference, figure) for figure in ("energy_wh", error))
    return np.array([energy, mae]).T


def _curves(results: Results, reference: str, error: str) -> Floats:
    """[S, 2, W]"""
    return np.stack([_points(results, name, reference, error) for name in OURS], axis=-1)


def _draw(axes: Axes, results: Results, names: Sequence[str], reference: str) -> None:
    ours = np.array(
        [points.mean(axis=0) for name in OURS if len(points := _points(results, name, reference))]
    )
    if len(ours):
        energy, mae = ours[np.argsort(ours[:, 0])].T
        axes.plot(energy, mae, "o-", color="tab:red", label="MPC-Twin, by weight of effort")
    seen: set[str] = set()
    for name in names:
        points = _points(results, name, reference)
        if name in OURS or not len(points):
            continue
        family = next(family for family in FAMILIES if name.startswith(family))
        marker, colour = FAMILIES[family]
        remark = next((f": {one.remark}" for one in results if one.entry == name and one.remark), "")
        label = "" if family in seen else family + remark
        seen.add(family)
        axes.plot(*points.mean(axis=0), marker, color=colour, label=label, markersize=6, alpha=0.8)
    axes.set_xlabel("energy of the heater [Wh]")
    axes.set_ylabel("MAE, true air [K]")
    axes.set_ylim(bottom=0.0)
    axes.set_title(reference.replace("_", " "))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
