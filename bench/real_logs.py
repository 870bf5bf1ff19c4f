"""Measured logs through the same tick: ARX fitted on some runs, its forecasts scored on others, in shadow.

python -m bench.real_logs [--data ../shared/data/heated_box] [--out bench/results]

What these logs can't show: the fan was on all the time, so its effect is not in them; there was no ambient
sensor, so the room's part of the loss is in the intercept.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge.app.replay import Series, decisions_digest, replay, score
from edge.commands.replay import settings_for, skill_table
from edge.core.messages import TickRecord
from edge.formats.run_file import RecordedRun, read_run
from edge.formats.run_lines import OPTION_WITHOUT
from edge.models.arx import Arx
from edge.models.fit_arx import fit_arx

STEP_S = 10.0
HORIZONS_S = (10.0, 30.0, 60.0, 120.0, 300.0)
REFERENCE_C = 23.0  # inside what the box reached, so that the shadow controller has something to do
TRAINING, VALIDATION = 5, 3  # runs in the order of their dates; the rest is only scored
SOURCE = "ESPerimentino PID, repository grobx/unimi-embedded-project, CC BY 4.0"


def split(paths: Sequence[Path]) -> tuple[list[RecordedRun], list[RecordedRun], list[RecordedRun]]:
    """Training, validation and test runs, by date: what comes later is not known when a model is fitted."""
    runs = [read_run(path, OPTION_WITHOUT) for path in sorted(paths)]
    end = TRAINING + VALIDATION
    return runs[:TRAINING], runs[TRAINING:end], runs[end:]


def main() -> None:
    """Print the table, save it and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/heated_box"))
    parser.add_argument("--out", type=Path, default=Path("bench/results"))
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    arguments = parser.parse_args()
    paths = list(arguments.data.glob("*.csv"))
    if not paths:
        raise SystemExit(f"{arguments.data}: no run files; they are from {SOURCE}")
    training, validation, test = split(paths)
    fit = fit_arx(training, validation, STEP_S, fan_input=None, with_ambient=False)
    model = replace(fit.model, version="real logs")
    settings = settings_for(STEP_S, "MPC", REFERENCE_C)
    replays = [replay(run, settings, model, fan_always_on=True) for run in test]
    # Twice, with the clock's limit in force: only then does it show that replays are exact.
    again = [replay(run, settings, model, fan_always_on=True) for run in test]
    same = [decisions_digest(a) == decisions_digest(b) for a, b in zip(replays, again, strict=True)]
    lines = [
        "python -m bench.real_logs",
        f"{len(training)} runs fitted, {len(validation)} to choose the orders, {len(test)} scored only; "
        f"steps of {STEP_S:g} s, {SOURCE}",
        f"ARX p = {len(model.temp)}, q = {len(model.heater)}, without fan and ambient",
        f"replayed twice: {sum(same)} of {len(same)} runs gave the same decisions bit for bit",
        "",
        *skill_table([score(records, model, HORIZONS_S) for records in replays]),
    ]
    print("\n".join(lines))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "real_logs.txt").write_text("\n".join(lines) + "\n")
    draw(replays[0], model, test[0], arguments.images / "real_logs.png")


def draw(records: Sequence[TickRecord], model: Arx, run: RecordedRun, path: Path) -> None:
    """Measured temperature with forecasts of 5 minutes from every third minute, and the inputs below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    minutes = run.columns["time_s"] / 60.0
    upper.plot(minutes, run.columns["temp_air_c"], color="black", linewidth=1.2, label="measured")
    series, reach = Series.of(records), round(300.0 / STEP_S)
    # Every third minute: more lines would hide the measurement.
    for index, tick in enumerate(range(model.rows_needed - 1, len(records) - 1, 18)):
        forecast = np.append(series.estimates[tick], series.forecast(model, tick, reach))
        start = (records[tick].time_s + STEP_S * np.arange(len(forecast))) / 60.0
        label = "forecast of 5 min, with the inputs that stood" if index == 0 else None
        upper.plot(start, forecast, color="tab:orange", linewidth=1.8, label=label)
    upper.set_ylabel("air temperature [°C]")
    upper.legend(loc="upper left")
    upper.set_title(f"Replay of a measured run, {run.path.stem if run.path else ''}")
    lower.step(
        minutes, run.columns["heater_duty"], where="post", color="tab:red", label="recorded heater duty"
    )
    wanted = [record.wanted.heater_duty for record in records]
    times = [record.time_s / 60.0 for record in records]
    label = f"what MPC would have wanted, for {REFERENCE_C:g} °C"
    lower.step(times, wanted, where="post", color="tab:blue", linewidth=0.9, label=label)
    lower.set_ylabel("heater duty")
    lower.set_ylim(-0.05, 1.55)
    lower.legend(loc="upper right", ncols=2, fontsize="small")
    lower.set_xlabel("time [min]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
