"""Dependences of an effect without a name: a heat in proportion to something that was recorded."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.twin_choice import TriedTwin, TwinChoice, block_squares, folds_of
from edge.diagnosis.twin_fit import with_slopes
from edge.twin.linearise import EnsembleRun, linearise, responses
from edge.twin.model import DAY_S
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
LESS = 0.2  # a logarithm: so much less must left-out rows be missed
MOST = 3
WARM, HOT = 0.4, 0.7  # of the way from the coldest to the warmest reading


class Dependence(NamedTuple):
    """Q = a * text [W], a in `unit`. less : how much less left-out rows are missed with it, a logarithm"""

    text: str
    unit: str
    signals: tuple[str, ...]
    less: float
    value: float


_Shape = tuple[str, str, tuple[str, ...], Floats]  # text, unit, signals, heat of each row for a = 1


def dependences(choice: TwinChoice, handed: TriedTwin) -> tuple[Dependence, ...]:
    """Return what most reduces the errors over left-out rows, one for each signal, strongest first."""
    runs, fit = choice.runs, handed.fit
    steps = linearise(fit.file.twin(), runs.batch)
    shapes = _shapes(runs.batch, choice.file.sample_s)
    shown = responses([EnsembleRun(steps, None, steps.heat * heat.T[..., None]) for *_, heat in shapes])
    folds, best = folds_of(runs), dict[tuple[str, ...], Dependence]()
    base = block_squares(with_slopes(fit, np.empty((0, *runs.seen.shape)), folds, runs)[0], folds)[0]
    for (text, unit, signals, _), response in zip(shapes, shown, strict=True):
        size = float(np.abs(response).max())
        if not size > 1e-9:
            continue
        errors, value = with_slopes(fit, response[None] / size, folds, runs)
        blocks, _ = block_squares(errors, folds)
        less = float(np.mean(0.5 * np.log((base + choice.noise_k**2) / (blocks + choice.noise_k**2))))
        if less > LESS and (signals not in best or less > best[signals].less):
            best[signals] = Dependence(text, unit, signals, less, float(value[0]) / size)
    return tuple(sorted(best.values(), key=lambda item: -item.less)[:MOST])


def _shapes(runs: RunBatch, step_s: float) -> list[_Shape]:
    """Heats that are not what a named effect is alone."""
    temps = np.stack([hold(row) for row in runs.temp])
    air = 0.5 * (temps[:, 1:] + temps[:, :-1])
    low, high = float(np.nanmin(runs.temp)), float(np.nanmax(runs.temp))
    excess, hours = air - runs.ambient, np.broadcast_to(np.arange(air.shape[1]) * step_s / 3600.0, air.shape)
    found: list[_Shape] = [
        ("u (T - T_amb)", "W/K", ("heater_duty", "temp_air"), runs.duty * excess),
        ("u^2", "W", ("heater_duty",), runs.duty**2),
        ("u fan", "W", ("heater_duty", "fan_on"), runs.duty * runs.fan),
        ("fan", "W", ("fan_on",), runs.fan),
        ("|T - T_amb| (T - T_amb)", "W/K²", ("temp_air",), np.abs(excess) * excess),
        ("t", "W/h", ("time",), hours),
        ("t (T - T_amb)", "W/K/h", ("time",), hours * excess),
    ]
    for share in (WARM, HOT):
        warm = round(low + share * (high - low), 1)
        above = np.maximum(air - warm, 0.0)
        found.append((f"max(T - {warm:g}, 0)", "W/K", ("temp_air",), above))
        found.append((f"u max(T - {warm:g}, 0)", "W/K", ("heater_duty", "temp_air"), runs.duty * above))
    conditions = runs.conditions
    if "light" in conditions:
        found.append(("L", "W", ("light",), conditions["light"]))
    if "rel_humidity" in conditions:
        dry = conditions["rel_humidity"] - 50.0
        found.append(("RH - 50", "W/%", ("rel_humidity",), dry))
        found.append(("(RH - 50) (T - T_amb)", "W/(% K)", ("rel_humidity", "temp_air"), dry * excess))
    if "utc" in conditions:
        turn = 2.0 * np.pi * (conditions["utc"] % DAY_S) / DAY_S
        found += [
            ("sin(day)", "W", ("time",), np.sin(turn)),
            ("cos(day)", "W", ("time",), np.cos(turn)),
        ]
    return [shape for shape in found if np.ptp(shape[-1]) > 0.0]
