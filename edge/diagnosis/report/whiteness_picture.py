"""Autocorrelation of the innovations, before and after."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.report.picture import AFTER, INK, PLAIN, Picture, legend_above, new_figure, style, svg
from edge.diagnosis.report.story import Floats, Story, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAGS = 40
LEAST_ROWS = 20  # fewer tell nothing
LEAST_REACH = 0.4  # of the axis


def whiteness_picture(story: Story, adds: bool) -> Picture | None:
    """None where innovations are not known. adds : whether after is another twin than before

    Of the last twin alone: each has noise of its own, and one that lacks an effect may take that for noise.
    """
    every = [one.innovations_after if adds else one.innovations_before for one in story.traces]
    parts = [one for one in every if one is not None]
    rows = _rows(parts)
    if rows < LEAST_ROWS:
        return None
    values = autocorrelation(parts)
    # Bartlett's band: autocorrelations of white noise have a standard deviation of 1/sqrt(rows).
    band = 1.96 / np.sqrt(rows)
    with style():
        figure = new_figure(2.4)
        axes = figure.subplots()
        axes.axhspan(-band, band, color=PLAIN, alpha=0.3, lw=0, label="95 % of white noise")
        axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
        _draw(axes, values, "twin after" if adds else "twin", _step_min(story.traces))
        axes.set_ylim(*_limits(values, band))
        axes.set_xlabel("lag [min]")
        axes.set_ylabel("autocorrelation")
        axes.set_title("Innovations: is anything left?")
        legend_above(axes, 2)
        return Picture(
            svg(figure),
            "Autocorrelation of the innovations",
            "Of all runs together. Where nothing is left to explain, almost all lie in the grey band.",
        )


def autocorrelation(parts: Sequence[Floats]) -> Floats:
    """Return the autocorrelation of several series together, at lags 1 to LAGS or a quarter of the longest.

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


def _draw(axes: "Axes", values: Floats, label: str, step_min: float) -> None:
    lags = np.arange(1, len(values) + 1) * step_min
    axes.vlines(lags, 0.0, values, color=AFTER, lw=1.2)
    axes.plot(lags, values, "o", color=AFTER, ms=3.2, label=label)


def _limits(values: Floats, band: float) -> tuple[float, float]:
    """Return axis limits by which a small correlation looks small."""
    reach = max(LEAST_REACH, 1.15 * band, 1.1 * float(np.abs(values).max(initial=0.0)))
    return -reach, reach


def _rows(parts: Sequence[Floats]) -> int:
    return int(sum(np.isfinite(part).sum() for part in parts))


def _step_min(traces: Sequence[Trace]) -> float:
    steps = [float(np.median(np.diff(one.time_s))) for one in traces if len(one.time_s) > 1]
    return float(np.median(steps)) / 60.0 if steps else 1.0
