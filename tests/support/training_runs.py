"""Small runs for the tests of the training workspace: a box of known physics, recorded without noise."""

from pathlib import Path

import numpy as np

from edge.core.predictor import Floats
from edge.formats.run_file import RecordedRun
from edge.twin.model import BoxTwin

STEP_S = 60.0
BOX = BoxTwin(
    effects={
        "extra_capacity": {"kC": 7.0},
        "wall_mass": {"C_w": 15000.0, "G_in": 7.0, "G_out": 11.0},
        "heater_lag": {"tau_h": 300.0},
        "fan_effectiveness": {"eps_f": 0.9},
    }
)


def box_run(seed: int, rows: int = 90, role: str = "train", box: BoxTwin = BOX) -> RecordedRun:
    """A run from rest in a room at 22 °C and then around, inputs held 5 minutes; its last fifth validates."""
    draw = np.random.default_rng(seed)
    duty = _held(draw.choice([0.0, 0.3, 0.6], size=rows), rows)
    fan = _held((draw.random(rows) < 0.3).astype(float), rows)
    ambient = 22.0 + 0.3 * np.sin(np.arange(rows) / 15.0)
    start = np.array([22.0 if name != "heater" else 0.0 for name in box.states])
    temp = box.rollout(start, duty[None, :-1], fan[None, :-1], ambient[:-1])[0]
    columns = {
        "time_s": STEP_S * np.arange(rows),
        "temp_air_c": np.append(22.0, temp),
        "temp_ambient_c": ambient,
        "heater_duty": duty,
        "fan_on": fan,
    }
    facts = {"role": role} | ({"validate_from_s": str(STEP_S * (rows * 4 // 5))} if role == "train" else {})
    return RecordedRun(columns, facts, Path(f"box_{seed}.csv"))


def _held(values: Floats, rows: int) -> Floats:
    return np.repeat(values, 5)[:rows]
