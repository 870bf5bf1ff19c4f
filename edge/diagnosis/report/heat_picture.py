"""Residual heat over what it depends on, before and after."""

from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.report.heat_variables import Variable, bins, explained_share, variables
from edge.diagnosis.report.number_text import percent
from edge.diagnosis.report.picture import FAN, HEATER, INK, Picture, new_figure, style, svg
from edge.diagnosis.report.story import Floats, Story, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DOTS = 1500  # most rows drawn in a panel
COLOURS, MARKERS = (HEATER, FAN), ("o", "s")


def heat_picture(story: Story, adds: bool) -> Picture | None:
    """None where no run has residual heat. adds : whether after is another twin than before"""
    traces = [one for one in story.traces if one.residual_heat_before_w is not None]
    if not traces:
        return None
    heats = {when: _heat(traces, when) for when in (("before", "after") if adds else ("before",))}
    # One condition for both panels, that of the twin before: two would not show what was closed.
    chosen = _choose(story, traces, heats["before"])
    if chosen is None:
        return None
    shown = {when: heat for when, heat in heats.items() if np.isfinite(heat).any()}
    with style():
        figure = new_figure(2.9)
        panels = figure.subplots(1, len(shown), sharey=True, sharex=True, squeeze=False)[0]
        for axes, (when, heat) in zip(panels, shown.items(), strict=True):
            _draw(axes, chosen, heat)
            axes.set_title(f"Residual heat {when}" if len(shown) > 1 else "Residual heat")
        figure.supxlabel(chosen.label, fontsize="medium")
        panels[0].set_ylabel("residual heat [W]")
        panels[0].set_ylim(*_limits(chosen, shown))
        handles, labels = panels[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside upper right", ncols=2)
        share = percent(max(explained_share(chosen, heats["before"]), 0.0))
        return Picture(
            svg(figure),
            f"Residual heat over {chosen.label}",
            "Residual heat: what must be added to the twin's air to make it show what was measured; below 0"
            " the twin gains too much. Large marks: means with twice their standard error; they explain"
            f" {share} of the variance before.",
        )


def _choose(story: Story, traces: list[Trace], heat: Floats) -> Variable | None:
    """Return the variable that the diagnosis names, if it can be drawn, else the one that explains most."""
    known = variables(traces)
    by_key = {one.key: one for one in known}
    for name in story.document["depends_on"]:
        if name in by_key:
            return by_key[name]
    return max(known, key=lambda one: explained_share(one, heat), default=None)


def _heat(traces: list[Trace], when: str) -> Floats:
    parts = [one.residual_heat_before_w if when == "before" else one.residual_heat_after_w for one in traces]
    rows = [len(one.time_s) for one in traces]
    return np.concatenate([np.full(n, np.nan) if p is None else p for p, n in zip(parts, rows, strict=True)])


def _draw(axes: "Axes", variable: Variable, heat: Floats) -> None:
    axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
    known = np.flatnonzero(np.isfinite(variable.x) & np.isfinite(heat))
    shown = known[:: max(1, len(known) // DOTS)]
    for group in (0, 1):
        rows = shown[variable.group[shown] == group]
        axes.plot(
            variable.x[rows], heat[rows], ".", ms=4.0, mew=0, color=COLOURS[group], alpha=0.4, rasterized=True
        )
        means = [_mean(variable.x[cell], heat[cell]) for cell, of in bins(variable, heat) if of == group]
        if means:
            x, mean, error = np.array(sorted(means)).T
            axes.errorbar(
                x,
                mean,
                2.0 * error,
                fmt="-" + MARKERS[group],
                color=COLOURS[group],
                ms=5.5,
                mec=INK,
                mew=0.6,
                lw=1.3,
                label=variable.groups[group],
            )


def _mean(x: Floats, heat: Floats) -> tuple[float, float, float]:
    return float(x.mean()), float(heat.mean()), float(heat.std(ddof=1) / np.sqrt(len(heat)))


def _limits(variable: Variable, heats: dict[str, Floats]) -> tuple[float, float]:
    """All means with their errors, and all dots but the farthest of a hundred."""
    values = np.concatenate([heat[np.isfinite(heat)] for heat in heats.values()])
    means = [
        _mean(variable.x[cell], heat[cell])[1:] for heat in heats.values() for cell, _ in bins(variable, heat)
    ]
    low = min(0.0, float(np.quantile(values, 0.01)), *(mean - 2.0 * error for mean, error in means))
    high = max(0.0, float(np.quantile(values, 0.99)), *(mean + 2.0 * error for mean, error in means))
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room
