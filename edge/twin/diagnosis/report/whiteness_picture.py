"""Autocorrelation of the innovations, before and after."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.twin.diagnosis.report.picture import (
    AFTER,
    BEFORE,
    INK,
    PLAIN,
    Picture,
    legend_above,
    new_figure,
    styled,
    svg,
)
from edge.twin.diagnosis.report.story import Floats, Story, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAGS = 40
LEAST_ROWS = 20  # fewer tell nothing


def whiteness_picture(story: Story, adds: bool) -> Picture | None:
    """None where innovations are not known. adds : whether after is another twin than before"""
    series = {
        "before": [one.innovations_before for one in story.traces if one.innovations_before is not None],
        "after": [
            one.innovations_after for one in story.traces if adds and one.innovations_after is not None
        ],
    }
    found = {when: autocorrelation(parts) for when, parts in series.items() if _rows(parts) >= LEAST_ROWS}
    if not found:
        return None
    step_min = _step_min(story.traces)
    band = 1.96 / np.sqrt(min(_rows(series[when]) for when in found))
    with styled():
        figure = new_figure(2.4)
        axes = figure.subplots()
        axes.axhspan(-band, band, color=PLAIN, alpha=0.3, lw=0, label="95 % of white noise")
        axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
        for number, (when, values) in enumerate(found.items()):
            shift = (number - 0.5 * (len(found) - 1)) * 0.4
            _draw(axes, values, when if adds else "twin", step_min, shift)
        axes.set_xlabel("lag [min]")
        axes.set_ylabel("autocorrelation")
        axes.set_title("Innovations: is anything left?")
        legend_above(axes, 3)
        return Picture(
            svg(figure),
            "Autocorrelation of the innovations",
            "Of all runs together. Where nothing is left to explain, almost all lie in the grey band.",
        )


def autocorrelation(parts: Sequence[Floats]) -> Floats:
    """Of several series together, at lags 1 to LAGS or a quarter of the longest.

    No lag crosses from a series to the next; what is missing is left out.
    """
    centred = [
        np.where(np.isfinite(part), part, np.nan) - np.nanmean(part[np.isfinite(part)])
        for part in parts
        if np.isfinite(part).any()
    ]
    variance = np.nanmean(np.concatenate(centred) ** 2)
    lags = min(LAGS, max(len(part) for part in centred) // 4)
    values = []
    for lag in range(1, lags + 1):
        products = np.concatenate([part[lag:] * part[:-lag] for part in centred])
        values.append(
            np.nanmean(products) / variance if variance > 0.0 and np.isfinite(products).any() else 0.0
        )
    return np.array(values)


def _draw(axes: "Axes", values: Floats, when: str, step_min: float, shift: float) -> None:
    lags = (np.arange(1, len(values) + 1) + shift) * step_min
    colour = BEFORE if when == "before" else AFTER
    marker = "s" if when == "before" else "o"
    axes.vlines(lags, 0.0, values, color=colour, lw=1.2)
    axes.plot(lags, values, marker, color=colour, ms=3.2, label=when)


def _rows(parts: Sequence[Floats]) -> int:
    return int(sum(np.isfinite(part).sum() for part in parts))


def _step_min(traces: Sequence[Trace]) -> float:
    steps = [float(np.median(np.diff(one.time_s))) for one in traces if len(one.time_s) > 1]
    return float(np.median(steps)) / 60.0 if steps else 1.0
