"""Runs of the independent chamber, one reading a row, driven without a board in between."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.hidden_effects.cases import STEP_S
from bench.hidden_effects.chamber_box import QUIET, chamber_of
from bench.hidden_effects.equations_inputs import Floats
from firmware_protocol.virtual_board.chamber import Chamber

LEAD_ROWS = 40  # driven before the first row, where the box does not begin at rest
COLUMNS = ("temp_air_c", "temp_ambient_c", "light", "rel_humidity_pct")


@dataclass(frozen=True, slots=True)
class RunPlan:
    """A run before it is driven.

    duty, fan, light : [LEAD_ROWS + rows], those before the first row included
    day, hour : of the first row; room_c : mean temperature of the room that day
    seed : of the chamber's noise and weather
    """

    duty: Floats
    fan: Floats
    light: Floats
    day: float
    hour: float
    room_c: float
    seed: int

    def shorten(self, rows: int) -> "RunPlan":
        """Return the first rows of the plan, begun at rest."""
        cut = [column[: LEAD_ROWS + rows].copy() for column in (self.duty, self.fan, self.light)]
        for column in cut[:2]:
            column[:LEAD_ROWS] = 0.0
        return replace(self, duty=cut[0], fan=cut[1], light=cut[2])

    @property
    def first(self) -> int:
        """Row at which the chamber begins, at rest: LEAD_ROWS where nothing happens before."""
        before = self.duty[:LEAD_ROWS].any() or self.fan[:LEAD_ROWS].any()
        return 0 if before else LEAD_ROWS


@dataclass(frozen=True, slots=True)
class DrivenRun:
    """Columns of a run, one number a row.

    shown : what the sensors show; clean_c : the air's without noise and steps
    start : true temperatures at the first row
    """

    shown: Mapping[str, Floats]
    clean_c: Floats
    start: Mapping[str, float]


def drive(settings: Mapping[str, float], plan: RunPlan) -> DrivenRun:
    """Run the chamber through a plan."""
    begun_h = (plan.first - LEAD_ROWS) * STEP_S / 3600.0
    there = {
        "room.temp_c": plan.room_c,
        "room.start_hour": (plan.hour + begun_h) % 24.0,
        "room.start_day": plan.day + begun_h / 24.0,
    }
    parameters, effects = chamber_of({**settings, **there})
    chamber = Chamber(parameters, effects, plan.seed)
    bias_k = effects.sensor_bias * parameters.sensors.air_bias_k
    drift_k_s = effects.sensor_drift * parameters.sensors.air_drift_k_day / 86400.0
    shown: list[dict[str, float]] = []
    clean, start = [], {}
    for k in range(plan.first, len(plan.duty)):
        if k == LEAD_ROWS:
            start = {key: item for key, item in chamber.truth().items() if key.startswith("temp_")}
        if k >= LEAD_ROWS:
            shown.append(chamber.sense())
            clean.append(chamber.truth()["temp_sensor_c"] + bias_k + drift_k_s * chamber.time_s)
        chamber.step(STEP_S, plan.duty[k], bool(plan.fan[k]), plan.light[k], False)
    columns = {name: np.array([row[name] for row in shown]) for name in COLUMNS}
    return DrivenRun(columns, np.array(clean), start)


def quiet_c(settings: Mapping[str, float], plan: RunPlan) -> Floats:
    """Return the air sensor's readings without noise, steps and disturbances."""
    return drive({**settings, **QUIET}, plan).clean_c


def believed_c(settings: Mapping[str, float], plan: RunPlan) -> Floats:
    """Return the readings as predicted by someone who trusts the room's
    sensor: its offset has no effect on the air.
    """
    switch, offset_k = (
        settings.get(key, 0.0) for key in ("effects.ambient_offset", "sensors.ambient_offset_k")
    )
    return quiet_c(settings, replace(plan, room_c=plan.room_c + switch * offset_k))
