"""The two standard plots of the residual of the twin as given: is it white, and which input moves it?

The residual is measured minus predicted from the row before, in standard deviations. The training runs are
taken together; no lag crosses from a run to the next.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge.diagnosis.report.picture import (
    BEFORE,
    FAN,
    HEATER,
    INK,
    PLAIN,
    Picture,
    legend_above,
    new_figure,
    style,
    svg,
)
from edge.diagnosis.report.story import Floats, Trace
from edge.diagnosis.report.wording import SIGNALS

LEAST_ROWS = 20  # fewer tell nothing
LAGS = 40
SURE = 1.358  # of Kolmogorov's distribution, 95 %
NORMAL = 1.96  # of the normal distribution, 95 %
COLOURS = {"heater_duty": HEATER, "fan_on": FAN}
RESIDUAL = "The residual of the twin as given is what it misses from a row to the next."


class Periodogram(NamedTuple):
    """frequency_h : [M] [1/h]; share : of the power up to there, 0..1, [M]; band : 95 % of white noise"""

    frequency_h: Floats
    share: Floats
    band: float


def cumulated_periodogram(traces: Sequence[Trace]) -> Periodogram | None:
    """Return the cumulated periodogram of the residuals, None where the rows are too few.

    Bartlett 1955, An Introduction to Stochastic Processes, 9.2; the band by Stephens 1974, JASA 69, as
    R's cpgram has it. A missing row counts as 0, the mean.
    """
    frequencies, powers = [], []
    for trace in traces:
        values = _centre(trace.innovations)
        seen = np.flatnonzero(values)
        if len(seen) < LEAST_ROWS:
            continue
        values = values[seen[0] : seen[-1] + 1]
        count = (len(values) - 1) // 2  # neither the mean nor the highest frequency, which has half the power
        powers.append((np.abs(np.fft.rfft(values)) ** 2 / (values**2).sum())[1 : count + 1])
        step_h = float(np.median(np.diff(trace.time_s))) / 3600.0
        frequencies.append(np.arange(1, count + 1) / (len(values) * step_h))
    if not powers:
        return None
    frequency, power = np.concatenate(frequencies), np.concatenate(powers)
    order = np.argsort(frequency, kind="stable")
    root = np.sqrt(len(power))
    band = SURE / (root + 0.12 + 0.11 / root)
    return Periodogram(frequency[order], np.cumsum(power[order]) / power.sum(), float(band))


def cross_correlations(traces: Sequence[Trace]) -> tuple[dict[str, Floats], float]:
    """Return the correlation of the residual with each input that moves, 0 to LAGS rows before it, and the
    95 % band of a white residual.
    """
    parts = [(_centre(one.innovations), one) for one in traces]
    rows = sum(int(np.count_nonzero(residual)) for residual, _ in parts)
    names = dict.fromkeys(name for one in traces for name in one.inputs)
    found: dict[str, Floats] = {}
    for name in names if rows >= LEAST_ROWS else ():
        pairs = [
            (residual, _centre(one.inputs[name], np.isfinite(one.innovations)))
            for residual, one in parts
            if one.innovations is not None and name in one.inputs
        ]
        size = np.sqrt(sum((r**2).sum() for r, _ in pairs) * sum((u**2).sum() for _, u in pairs))
        if size > 0.0:
            lags = range(min(LAGS, max(len(r) for r, _ in pairs) // 4) + 1)
            sums = [sum((r[lag:] * u[: len(u) - lag]).sum() for r, u in pairs) for lag in lags]
            found[name] = np.array(sums) / size
    return found, NORMAL / np.sqrt(max(rows, 1))


def _centre(values: Floats | None, counted: object = True) -> Floats:
    """Return values minus the mean of those counted, 0 where missing."""
    if values is None:
        return np.zeros(0)
    known = np.isfinite(values)
    used = known & counted
    return np.where(known, values - values[used].mean() if used.any() else 0.0, 0.0)


def residual_plots(traces: Sequence[Trace]) -> list[Picture]:
    """Both, none where no run has enough innovations."""
    traces = [one for one in traces if one.innovations is not None]
    found = cumulated_periodogram(traces)
    drawn = [] if found is None else [_draw_periodogram(found)]
    correlations, band = cross_correlations(traces)
    if correlations:
        steps = [float(np.median(np.diff(one.time_s))) for one in traces]
        drawn.append(_draw_correlations(correlations, band, float(np.median(steps)) / 60.0))
    return drawn


def _draw_periodogram(found: Periodogram) -> Picture:
    even = np.arange(1, len(found.share) + 1) / len(found.share)
    outside = float(np.abs(found.share - even).max()) > found.band
    with style():
        figure = new_figure(2.5)
        axes = figure.subplots()
        axes.fill_between(
            found.frequency_h, even - found.band, even + found.band, color=PLAIN, alpha=0.3, lw=0,
            label="95 % of white noise",
        )  # fmt: skip
        axes.plot(found.frequency_h, found.share, color=BEFORE, label="residual")
        axes.set_xlim(0.0, float(found.frequency_h[-1]))
        axes.set_ylim(0.0, 1.0)
        axes.set_xlabel("frequency [1/h]")
        axes.set_ylabel("share of the power")
        axes.set_title("Is the residual white? Cumulated periodogram")
        legend_above(axes, 2)
        leaves = "it leaves the band" if outside else "it stays inside"
        return Picture(
            svg(figure),
            "Cumulated periodogram of the residual of the twin as given",
            f"{RESIDUAL} White noise stays inside the band; here {leaves}. A rise on the left means"
            " errors that last for long.",
        )


def _draw_correlations(found: dict[str, Floats], band: float, step_min: float) -> Picture:
    with style():
        figure = new_figure(0.85 * len(found) + 0.8)
        panels = figure.subplots(len(found), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, values) in zip(panels, found.items(), strict=True):
            colour = COLOURS.get(name, BEFORE)
            axes.axhspan(-band, band, color=PLAIN, alpha=0.3, lw=0)
            axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
            axes.vlines(np.arange(len(values)) * step_min, 0.0, values, color=colour, lw=2.0)
            reach = max(1.3 * band, 1.15 * float(np.abs(values).max()))
            axes.set_ylim(-reach, reach)
            axes.set_title(SIGNALS.get(name, name), fontsize=8.4, fontweight="normal", pad=3.0)
        figure.suptitle(
            "Which input moves it? Cross-correlation", x=0.01, ha="left", fontsize=9.5, fontweight="bold"
        )
        panels[-1].set_xlabel("time from the input to the residual [min]")
        return Picture(
            svg(figure),
            "Cross-correlation of the residual of the twin as given with each input that moves",
            "Grey: 95 % of a white residual. An input whose bars leave it acts otherwise than the twin says,"
            " at that time after it.",
        )
