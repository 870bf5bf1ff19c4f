"""The pictures of the comparison, as PNG bytes: scenarios in the paper's form, bars, radar."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge.core.predictor import Floats
from edge.formats.run_file import RecordedRun
from training.evaluate.report import LABELS
from training.evaluate.resources import ModelCost
from training.evaluate.scores import TrainingScore, by_seed, maes
from training.models.rollout import START_ROWS
from training.models.saved_training import OURS, PAPER
from training.models.study import SCENARIOS, Regime

COLOURS = {
    "linear": "tab:blue",
    "pbm": "tab:gray",
    "lstm": "tab:orange",
    "ham": "tab:red",
    "pbm_fitted": "tab:brown",
    "linear_ambient": "tab:cyan",
    "twin": "tab:purple",
    "lstm_increment": "tab:olive",
    "ham_guarded": "tab:green",
}
MODELS = (*PAPER, *OURS)
BANDS = ("lstm", "ham", "ham_guarded")  # more of them hide each other
DPI = 74  # the pictures lie in the repository
ROOM_K = 1.5  # above and below what was measured: the rest of the axis is for the models
FASTEST_S = 1e-3  # training times below it are one tick of a clock
INNERMOST = 0.15  # of the radar's radius, so that a best model still has an area
AXES = ("error,\ninterpolation", "error,\nextrapolation", "training time", "memory")


def scenario_picture(run: RecordedRun, forecasts: Mapping[str, Sequence[Floats]], title: str) -> bytes:
    """Temperature measured and predicted, fan, heater, stacked.

    forecasts : by model, free runs [rows - START_ROWS] of its seeds [°C]: mean as a line, range as a band
    """
    figure = Figure(figsize=(9, 7), layout="constrained")
    air, fan, heater = figure.subplots(3, 1, sharex=True, height_ratios=(5, 1, 1.4))
    minutes = run.columns["time_s"] / 60.0
    measured = run.columns["temp_air_c"]
    lowest, highest = np.nanmin(measured) - ROOM_K, np.nanmax(measured) + ROOM_K
    for model, runs in forecasts.items():
        _draw_model(air, model, minutes[START_ROWS:], np.stack(runs), (lowest, highest))
    air.plot(minutes, measured, color="black", linewidth=1.6, label="measured", zorder=5)
    air.set_ylim(lowest, highest)
    air.set_ylabel("air temperature [°C]")
    air.set_title(title)
    air.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3, fontsize="small", frameon=False)
    _steps(fan, minutes, run.columns["fan_on"], "tab:blue")
    fan.set_yticks([0, 1], ["off", "on"])
    fan.set_ylabel("fan")
    _steps(heater, minutes, run.columns["heater_duty"], "tab:red")
    heater.set_ylabel("heater duty")
    heater.set_xlabel("time [min]")
    return png(figure)


def bars_picture(scores: Sequence[TrainingScore], regime: Regime) -> bytes:
    """Free-run MAE by model and scenario on a logarithmic axis; whiskers from the best to the worst seed."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    places, width = np.arange(len(MODELS)), 0.26
    for i, number in enumerate(SCENARIOS[regime]):
        columns = [maes(scores, model, regime)[:, i] for model in MODELS]
        means = np.array([column.mean() for column in columns])
        reach = np.array([[m - c.min(), c.max() - m] for m, c in zip(means, columns, strict=True)]).T
        bars = axes.bar(
            places + (i - 1) * width, means, width, yerr=reach, capsize=2, label=f"scenario {number}"
        )
        axes.bar_label(
            bars, [f"{mean:.2g}" if mean < 10 else f"{mean:.0f}" for mean in means], fontsize=7, padding=2
        )
    axes.set_yscale("log")
    axes.set_ylim(0.05, 700)
    axes.set_xticks(places, [LABELS[model].replace(" ", "\n", 1) for model in MODELS], fontsize="small")
    axes.axvline(len(PAPER) - 0.5, color="black", linewidth=0.8, linestyle=":")
    axes.text(len(PAPER) - 0.55, 450, "the paper's", ha="right", fontsize="small")
    axes.text(len(PAPER) - 0.45, 450, "beyond the paper", fontsize="small")
    axes.set_ylabel("free-run MAE [K], logarithmic")
    axes.set_title(f"{regime.capitalize()}: mean of the seeds, whiskers from best to worst seed")
    axes.legend(loc="upper right", fontsize="small")
    return png(figure)


def radar_picture(scores: Sequence[TrainingScore], costs: Sequence[ModelCost]) -> bytes:
    """Error, training time and memory of the paper's four and of our hybrid; the smaller the better."""
    shown = (*PAPER, "ham_guarded")
    by_model = {cost.model: cost for cost in costs}
    columns = [
        *(
            [float(np.mean(by_seed(scores, m, regime, len(maes(scores, m, regime))))) for m in shown]
            for regime in SCENARIOS
        ),
        [max(by_model[m].train_s, FASTEST_S) for m in shown],
        [by_model[m].running_kib for m in shown],
    ]
    radii = np.stack([radar_radii(column) for column in columns], axis=1)
    # An eighth of a turn on: no axis label lies over the title or the legend.
    angles = np.linspace(0.0, 2.0 * np.pi, len(AXES), endpoint=False) + np.pi / 4.0
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.subplots(subplot_kw={"projection": "polar"})
    for model, row in zip(shown, radii, strict=True):
        closed = np.append(row, row[0])
        axes.plot(
            np.append(angles, angles[0]),
            closed,
            "o-",
            color=COLOURS[model],
            label=LABELS[model],
            markersize=4,
        )
        axes.fill(np.append(angles, angles[0]), closed, color=COLOURS[model], alpha=0.08)
    limits = [f"{min(column):.3g} to {max(column):.3g}" for column in columns]
    units = ("K", "K", "s", "KiB")
    labels = [f"{axis}\n{limit} {unit}" for axis, limit, unit in zip(AXES, limits, units, strict=True)]
    axes.set_xticks(angles, labels)
    axes.tick_params(axis="x", pad=30)
    axes.set_yticks([INNERMOST, 1.0], ["", ""])
    axes.set_ylim(0.0, 1.05)
    axes.set_title("Inside is better; each axis logarithmic from the best to the worst of these")
    figure.legend(loc="outside lower center", ncols=len(shown), fontsize="small")
    return png(figure)


def radar_radii(values: Sequence[float]) -> Floats:
    """Place values above 0 on an axis: INNERMOST the least, 1 the largest, logarithmic between."""
    logs = np.log(np.asarray(values, dtype=np.float64))
    reach = logs.max() - logs.min()
    shares = (logs - logs.min()) / reach if reach > 0.0 else np.zeros_like(logs)
    return np.asarray(INNERMOST + (1.0 - INNERMOST) * shares)


def _draw_model(axes: Axes, model: str, minutes: Floats, runs: Floats, limits: tuple[float, float]) -> None:
    """Mean of the seeds and their range; a label says where a model leaves the picture."""
    mean, (lowest, highest) = runs.mean(axis=0), limits
    label = LABELS[model]
    gone = (mean < lowest) | (mean > highest)
    if gone.mean() > 0.5:
        worst = mean[np.abs(mean - np.mean(limits)).argmax()]
        label += f" (beyond the axis from minute {minutes[gone.argmax()]:.0f}, up to {worst:.0f} °C)"
    style = "-" if model in PAPER else "--"
    width = 0.7 if model == "pbm" else 1.2
    axes.plot(minutes, mean, style, color=COLOURS[model], linewidth=width, label=label)
    if model in BANDS and len(runs) > 1:
        axes.fill_between(
            minutes, runs.min(axis=0), runs.max(axis=0), color=COLOURS[model], alpha=0.13, linewidth=0
        )


def _steps(axes: Axes, minutes: Floats, values: Floats, colour: str) -> None:
    axes.fill_between(minutes, values, step="post", color=colour, alpha=0.35, linewidth=0)
    axes.step(minutes, values, where="post", color=colour, linewidth=0.8)
    axes.set_ylim(-0.05, 1.08)


def png(figure: Figure) -> bytes:
    """As all pictures of a comparison are drawn."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, pil_kwargs={"optimize": True})
    return out.getvalue()
