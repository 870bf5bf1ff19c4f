"""The pictures of the comparison, as PNG bytes, in the paper's form: runs and MAE bars."""

from collections.abc import Mapping, Sequence
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from training.control.comparison import BY, Results, column, rows_of
from training.control.figures import mean_of
from training.evaluate.pictures import png

Floats = NDArray[np.float64]
LABEL_LETTERS = 28  # in a line below a bar
COLUMN_IN, ROWS_IN = 3.6, (2.8, 0.6, 1.2)  # width of a controller's column; temperature, fan, heater


def runs_picture(title: str, runs: Mapping[str, Mapping[str, Floats]]) -> bytes:
    """Temperature with reference, fan, heater duty with its average; one column per controller."""
    figure = Figure(figsize=(COLUMN_IN * len(runs), sum(ROWS_IN) + 1.2), layout="constrained")
    axes = figure.subplots(3, len(runs), sharex=True, sharey="row", squeeze=False, height_ratios=ROWS_IN)
    for place, (name, columns) in enumerate(runs.items()):
        _draw_run(list(axes[:, place]), name, columns)
    for axis, label in zip(axes[:, 0], ("air [°C]", "fan", "heater duty"), strict=True):
        axis.set_ylabel(label)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    figure.suptitle(title, fontsize="medium")
    return png(figure)


def _draw_run(axes: Sequence[Axes], name: str, columns: Mapping[str, Floats]) -> None:
    temperature, fan, heater = axes
    hours = (columns["time_s"] - columns["time_s"][0]) / 3600.0
    temperature.set_title(name, fontsize="medium")
    temperature.plot(hours, columns["true_air_c"], color="tab:red", lw=1.0, label="air (true)")
    temperature.step(
        hours, columns["reference_c"], "--", where="post", color="black", lw=0.9, label="reference"
    )
    temperature.plot(hours, columns["temp_ambient_c"], color="tab:blue", lw=0.8, label="room (measured)")
    temperature.grid(alpha=0.3)
    fan.fill_between(hours, columns["fan_on"], step="post", color="tab:green", lw=0)
    fan.set_yticks([0.0, 1.0], ["off", "on"])
    heater.fill_between(hours, columns["heater_duty"], step="post", color="tab:orange", alpha=0.6, lw=0)
    mean = float(columns["heater_duty"].mean())
    heater.axhline(mean, ls="--", color="black", lw=1)
    heater.set_title(f"average {mean:.2f}", loc="right", fontsize="x-small", pad=2)
    heater.set_ylim(0.0, 1.05)
    heater.set_xlim(0.0, hours[-1])
    heater.set_xlabel("time [h]")


def bars_picture(results: Results, names: Sequence[str], references: Sequence[str]) -> bytes:
    """Draw the true MAE by controller and reference, whiskers: 95 % confidence over the seeds."""
    present = rows_of(results, names)
    figure = Figure(figsize=(max(7.0, 0.62 * len(present) + 1.5), 4.4), layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(references)
    for i, reference in enumerate(references):
        found = {name: column(results, name, reference, "mae_true") for name in present}
        means = {name: mean_of(values) for name, values in found.items() if values}
        places = [present.index(name) + (i - 0.5 * (len(references) - 1)) * width for name in means]
        halves = [mean.half if np.isfinite(mean.half) else 0.0 for mean in means.values()]
        values = [mean.value for mean in means.values()]
        bars = axes.bar(places, values, width, yerr=halves, capsize=2, label=reference.replace("_", " "))
        axes.bar_label(bars, [f"{value:.2f}" for value in values], fontsize=6.5, padding=2)
    models = {one.model for one in results if one.model}
    shown = [row.partition(BY)[0] if len(models) == 1 else row for row in present]
    labels = ["\n".join(wrap(row, LABEL_LETTERS)) for row in shown]
    axes.set_xticks(range(len(present)), labels, rotation=60, ha="right", fontsize="small")
    axes.set_ylabel("MAE, true air [K]")
    axes.margins(y=0.08)  # for the labels over the intervals
    axes.set_ylim(bottom=0.0)  # two seeds give intervals that go below
    axes.axhspan(0.0, 0.5, color="black", alpha=0.06, lw=0)
    decided = f"LLM: decided by {models.pop()}. " if len(models) == 1 else ""
    axes.set_title(f"-P: with penalty. {decided}Grey: within the sensor's ±0.5 K", fontsize="medium")
    axes.legend(fontsize="small")
    return png(figure)
