"""Residuals of a twin over one run, row by row, with the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.heat_filter import Steps, filter_heat
from edge.diagnosis.locate.residual_heat import ResidualHeat, likeliest, residual_heat
from edge.diagnosis.locate.whitening import pulses, white
from edge.twin.fit import free_run
from edge.twin.model import BoxTwin
from edge.twin.network import AIR
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """One run of N steps. Residuals are measured minus predicted after each step, NaN where not measured.

    time_s : [N], when each step begins; start_utc : of time 0 [s since 1970], None where not known
    measured : [N + 1] [°C]
    free_run_k : [N], of a free run from the best start
    one_step_k, innovation_sd : [N], of a filter that believes the twin but for white noise in its heat
    duty, fan, ambient, light, rel_humidity : [N], over each step, the last two None where not recorded
    heat_w, heat_w_sd : [N], the heat that explains it, above 0 where the box gains more than the twin [W]
    air_c : [N], mean of the air over each step as expected from the rows before it, noise filtered out
    white : [N], innovations of the filter that tracks the heat, in standard deviations, 0 where not measured
    response : [N, J], what 1 W in a step does to `white` from its row on (`whitened.pulses`)
    """

    name: str
    step_s: float
    start_utc: float | None
    time_s: Floats
    measured: Floats
    free_run_k: Floats
    one_step_k: Floats
    innovation_sd: Floats
    duty: Floats
    fan: Floats
    ambient: Floats
    light: Floats | None
    rel_humidity: Floats | None
    heat_w: Floats
    heat_w_sd: Floats
    air_c: Floats
    white: Floats
    response: Floats

    @property
    def excess_k(self) -> Floats:
        """T - T_amb over each step [K], [N]."""
        return np.asarray(self.air_c - self.ambient)

    @property
    def counted(self) -> Mask:
        """Rows of which the error is known, [N]."""
        return np.isfinite(self.free_run_k) & np.isfinite(self.heat_w)


def residuals_of(
    twin: BoxTwin,
    runs: RunBatch,
    names: Sequence[str],
    sensor_k: float | None = None,
    heat: ResidualHeat | None = None,
) -> list[Residuals]:
    """Return the residuals of each run, up to its last measurement.

    names : of the B runs; sensor_k : sd of a measured temperature [K], the twin's own where None
    heat : of the same twin and runs, where it is known already
    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    sensor_k = twin.noise.sensor_k if sensor_k is None else sensor_k
    heat = heat or residual_heat(twin, runs, sensor_k)
    free = free_run(twin, runs, runs.ambient, max(sensor_k, _misfit(heat)))
    free_k = np.where(free.measured, free.residual, np.nan)
    # Innovations of a filter without unknown heat: with it there would be none left to judge by.
    believed = _without_heat(heat.steps)
    alone = filter_heat(believed, sensor_k, likeliest(believed, sensor_k, wander_w=(0.0,)))
    told, response = white(heat.way), pulses(heat.steps, heat.way)
    air_c = _mean_air(heat, twin.states.index(AIR))
    found = []
    for i, name in enumerate(names):
        rows = int(np.flatnonzero(free.measured[i]).max(initial=-1)) + 1
        columns = {key: column[i, :rows] for key, column in runs.conditions.items()}
        found.append(
            Residuals(
                name,
                twin.step_s,
                float(runs.conditions["utc"][i, 0]) if "utc" in columns else None,
                twin.step_s * np.arange(rows, dtype=np.float64),
                runs.temp[i, : rows + 1],
                free_k[i, :rows],
                alone.innovation[:rows, i],
                alone.variance[:rows, i] ** 0.5,
                runs.duty[i, :rows],
                runs.fan[i, :rows],
                runs.ambient[i, :rows],
                columns.get("light"),
                columns.get("rel_humidity"),
                heat.heat_w[i, :rows],
                heat.sd_w[i, :rows],
                air_c[i, :rows],
                told[i, :rows],
                response[i, :rows, :rows],
            )
        )
    return found


def _mean_air(heat: ResidualHeat, air: int) -> Floats:
    """Mean over each step, of air that nears its end exponentially, by the rows before it, [B, N]."""
    left = np.clip(heat.steps.matrix[:, :, air, air], 1e-6, 1.0 - 1e-6)  # of a difference, after a step
    mean_left = (left - 1.0) / np.log(left)
    of_begin = (mean_left - left) / (1.0 - left)
    begin, end = heat.way.updated[:-1, :, air], heat.way.mean[1:, :, air]
    return np.asarray(of_begin * begin + (1.0 - of_begin) * end).T


def _misfit(heat: ResidualHeat) -> float:
    """Size of the innovations [K]: what a free run misses is no smaller."""
    return float(np.sqrt(np.nanmean(heat.way.innovation**2)))


def _without_heat(steps: Steps) -> Steps:
    """Return the steps of a twin that is trusted: no unknown heat at the start."""
    return replace(steps, start_sd=np.append(steps.start_sd[:-2], [0.0, 0.0]))
