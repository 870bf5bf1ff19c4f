"""Residuals of a twin over one run, row by row, with the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residual_heat import ResidualHeat, filter_heat, likeliest, residual_heat
from edge.twin.fit import free_run
from edge.twin.model import BoxTwin
from edge.twin.network import AIR
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """One run of N steps. Residuals are measured minus predicted after each step, NaN where not measured.

    utc_s : [N], when each step begins [s since 1970], None where not known
    free_run_k : [N], of a free run from the best start
    innovation : [N], in standard deviations, of a filter that believes the twin but for white noise
    duty, fan, ambient, light, rel_humidity : [N], over each step, the last two None where not recorded
    heat_w : [N], the heat that explains it, above 0 where the box gains more than the twin [W]
    air_c : [N], mean of the air over each step as expected from the rows before it, noise filtered out
    """

    name: str
    step_s: float
    utc_s: Floats | None
    free_run_k: Floats
    innovation: Floats
    duty: Floats
    fan: Floats
    ambient: Floats
    light: Floats | None
    rel_humidity: Floats | None
    heat_w: Floats
    air_c: Floats

    @property
    def excess_k(self) -> Floats:
        """T - T_amb over each step [K], [N]."""
        return np.asarray(self.air_c - self.ambient)


def residuals_of(
    twin: BoxTwin, runs: RunBatch, names: Sequence[str], sensor_k: float | None = None
) -> list[Residuals]:
    """Return the residuals of each run, up to its last measurement.

    names : of the B runs; sensor_k : sd of a measured temperature [K], the twin's own where None
    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    sensor_k = twin.noise.sensor_k if sensor_k is None else sensor_k
    heat = residual_heat(twin, runs, sensor_k)
    missed_k = float(np.sqrt(np.nanmean(heat.way.innovation**2)))  # what a free run misses is no smaller
    free = free_run(twin, runs, runs.ambient, max(sensor_k, missed_k))
    # Innovations of a filter without unknown heat: with it there would be none left to judge by.
    believed = replace(heat.steps, start_sd=np.append(heat.steps.start_sd[:-2], [0.0, 0.0]))
    alone = filter_heat(believed, sensor_k, likeliest(believed, sensor_k, wander_w=(0.0,)))
    air_c = _mean_air(heat, twin.states.index(AIR))
    found = []
    for i, name in enumerate(names):
        rows = int(np.flatnonzero(free.measured[i]).max(initial=-1)) + 1
        columns = {key: column[i, :rows] for key, column in runs.conditions.items()}
        found.append(
            Residuals(
                name=name,
                step_s=twin.step_s,
                utc_s=columns.get("utc"),
                free_run_k=np.where(free.measured[i], free.residual[i], np.nan)[:rows],
                innovation=alone.innovation[:rows, i] / alone.variance[:rows, i] ** 0.5,
                duty=runs.duty[i, :rows],
                fan=runs.fan[i, :rows],
                ambient=runs.ambient[i, :rows],
                light=columns.get("light"),
                rel_humidity=columns.get("rel_humidity"),
                heat_w=heat.heat_w[i, :rows],
                air_c=air_c[i, :rows],
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
