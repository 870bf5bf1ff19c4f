"""Days of several controllers side by side, in the form of the paper's figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

COLUMN_IN = 5.2  # width of one controller's column
HEIGHTS = (3.0, 0.5, 1.3)  # temperature, fan, heater


class Drawn(Protocol):
    """What is drawn of a day."""

    @property
    def controller(self) -> str: ...
    @property
    def columns(self) -> Mapping[str, NDArray[np.float64]]: ...


def draw(days: Sequence[Drawn], out: Path) -> None:
    """Air temperature with reference and ambient, fan, heater duty with its average; one column per day."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(COLUMN_IN * len(days), sum(HEIGHTS) + 0.9), layout="constrained")
    axes = figure.subplots(3, len(days), sharex=True, sharey="row", squeeze=False, height_ratios=HEIGHTS)
    for (temperature, fan, heater), day in zip(axes.T, days, strict=True):
        columns = day.columns
        hours = (columns["time_s"] - columns["time_s"][0]) / 3600.0
        temperature.set_title(day.controller, loc="left")
        temperature.plot(hours, columns["temp_air_c"], color="#c0392b", lw=0.9, label="air")
        temperature.step(
            hours, columns["reference_c"], "--", where="post", color="black", lw=1, label="reference"
        )
        temperature.plot(hours, columns["temp_ambient_c"], color="#2874a6", lw=0.9, label="ambient")
        temperature.grid(alpha=0.3)
        fan.fill_between(hours, columns["fan_on"], step="post", color="#117864", lw=0)
        fan.set_yticks([0.0, 1.0], ["off", "on"])
        heater.fill_between(hours, columns["heater_duty"], step="post", color="#ca6f1e", alpha=0.6, lw=0)
        mean = float(columns["heater_duty"].mean())
        heater.axhline(mean, ls="--", color="black", lw=1, label=f"average {mean:.2f}")
        heater.legend(loc="upper left", bbox_to_anchor=(0.0, 1.3), fontsize="small", frameon=False)
        heater.set_ylim(0.0, 1.05)
        heater.set_xlim(0.0, hours[-1])
        heater.set_xlabel("time [h]")
    axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize="small", frameon=False)
    for axis, label in zip(axes[:, 0], ("temperature [°C]", "fan", "heater duty [0..1]"), strict=True):
        axis.set_ylabel(label)
    figure.savefig(out, dpi=110)
