"""Run by the program of an installed package: print what it computes, for comparison with another processor.

Forecasts of the four packaged predictors and the bundle's twin [degC], an hour of ticks of a whole daemon in
lock-step with the virtual board, and the most memory that one of its processes took [MB].
"""

import json
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np

from edge.bundle.predictors import loader
from edge.bundle.store import BundleStore

ROWS, SEQUENCES, STEPS = 120, 64, 60
TOLERANCE_K = 1e-5
NOWHERE = Path("/nonexistent")
DEMO = ("demo", "--speed", "0", "--minutes", "60", "--controller", "MPC-P")


def forecasts() -> dict[str, list[list[float]]]:
    """Return the forecasts of drawn plans after a drawn history, by predictor."""
    draw = np.random.default_rng(20)
    hour = np.arange(ROWS + STEPS) / 60.0
    columns = {
        "temp_air": 24.0 + 4.0 * np.sin(hour) + draw.normal(0.0, 0.1, ROWS + STEPS),
        "temp_ambient": 20.0 + np.cos(hour),
        "heater_duty": draw.integers(0, 21, ROWS + STEPS) / 20.0,
        "fan_on": draw.integers(0, 2, ROWS + STEPS).astype(float),
        "light": np.zeros(ROWS + STEPS),
        "utc": 1.7e9 + 3600.0 * hour,
    }
    history = {name: values[:ROWS] for name, values in columns.items()}
    ahead = {name: values[ROWS:] for name, values in columns.items()}
    duty, fan = draw.integers(0, 21, (SEQUENCES, STEPS)) / 20.0, draw.integers(0, 2, (SEQUENCES, STEPS))
    controls = np.stack([duty, fan.astype(float)], axis=-1)
    bundle = BundleStore(NOWHERE, NOWHERE, loader(60.0)).load("packaged")
    return {name: p.rollout(history, controls, ahead).tolist() for name, p in bundle.predictors.items()}


def ticks() -> list[str]:
    """Return an hour's ticks as the demo prints them, without events: those name this demo's folder."""
    done = subprocess.run([sys.executable, "-m", "edge", *DEMO], capture_output=True, text=True, check=True)
    return re.findall(r"^\d\d:\d\d:\d\d  tick .*?(?=  safety)", done.stdout, re.MULTILINE)


def is_parity(own: dict[str, list[list[float]]], other: dict[str, list[list[float]]]) -> bool:
    """Print the largest differences; True when all are within the tolerance."""
    worst = {name: np.abs(np.asarray(own[name]) - np.asarray(values)).max() for name, values in other.items()}
    for name, difference in worst.items():
        print(f"{name:6} {SEQUENCES * STEPS} temperatures, largest difference {difference:.1e} K")
    return all(difference <= TOLERANCE_K for difference in worst.values())  # NaN is not


if __name__ == "__main__":
    found = {"forecasts": forecasts(), "ticks": ticks()}
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    Path(sys.argv[1]).write_text(json.dumps(found))
    print(f"{len(found['ticks'])} ticks, peak {peak_mb:.0f} MB; the last: {found['ticks'][-1]}")
    if len(sys.argv) > 2:
        other = json.loads(Path(sys.argv[2]).read_text())
        print(f"the ticks are {'the same' if found['ticks'] == other['ticks'] else 'not the same'}")
        sys.exit(0 if is_parity(found["forecasts"], other["forecasts"]) else 1)
