"""python -m bench.twin: the physics model's exact steps in a batch beside SciPy's RK45, step by step.

Both solve the same equations from the same start with the same random inputs, in one process and one thread.
The times are the least of several runs; the difference is over all steps of the sequence that RK45 solves.
"""

import argparse
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from edge.twin.effects.library import Effects
from edge.twin.model import BoxTwin
from edge.twin.reference import rk45_rollout
from edge.twin.warm_start import at_rest

BATCHES = (1, 42, 2000)
HORIZON = 20
RK45_STEPS = 200
AMBIENT_C = 21.0
TWINS: dict[str, Effects] = {
    "bare PBM": {},
    "loss and capacity": {"wall_loss": {"UA": 4.1}, "extra_capacity": {"kC": 32.0}},
    "wall, lag, capacity": {
        "wall_mass": {"C_w": 18000.0, "G_in": 6.0, "G_out": 11.0},
        "heater_lag": {"tau_h": 650.0},
        "extra_capacity": {"kC": 6.0},
    },
}


@dataclass(frozen=True, slots=True)
class TwinRow:
    """A twin's times for one step [us], and how far RK45's default tolerances are off [K]."""

    rk45_us: float
    exact_us: list[float]  # by BATCHES
    off_tight_k: float
    off_default_k: float

    def __str__(self) -> str:
        cells = [f"{self.rk45_us:.0f}", *(f"{us:.3f}" for us in self.exact_us)]
        cells += [f"{self.rk45_us / self.exact_us[-1]:,.0f}", f"{self.off_tight_k:.1e}"]
        return " | ".join([*cells, f"{self.off_default_k:.1e}"])


def least_s(call: Callable[[], object], repeats: int) -> float:
    """Least wall time of several calls [s]."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        call()
        times.append(time.perf_counter() - begun)
    return min(times)


def measure(effects: Effects, repeats: int) -> TwinRow:
    """Time one twin."""
    twin, random = BoxTwin(effects=effects), np.random.default_rng(1)
    start = at_rest(twin, 24.0, AMBIENT_C)
    exact_us = []
    for batch in BATCHES:
        duty = random.integers(0, 21, (batch, HORIZON)) / 20.0
        fan = (random.uniform(size=(batch, HORIZON)) < 0.3).astype(np.float64)
        seconds = least_s(partial(twin.rollout, start, duty, fan, AMBIENT_C), repeats)
        exact_us.append(1e6 * seconds / (batch * HORIZON))
    # The bare box keeps all its heat: with the fan off it has to be heated little to stay a greenhouse.
    fan = (random.uniform(size=RK45_STEPS) < 0.3).astype(np.float64)
    duty = random.integers(0, 21, RK45_STEPS) / 20.0 * np.where(fan > 0.0, 1.0, 0.02)
    ambient = np.full(RK45_STEPS, AMBIENT_C)
    exact = twin.rollout(start, duty[None], fan[None], AMBIENT_C)[0]
    default = rk45_rollout(twin, start, duty, fan, ambient)[:, 0]
    tight = rk45_rollout(twin, start, duty, fan, ambient, rtol=1e-10, atol=1e-10)[:, 0]
    seconds = least_s(lambda: rk45_rollout(twin, start, duty, fan, ambient), max(1, repeats // 10))
    return TwinRow(
        1e6 * seconds / RK45_STEPS,
        exact_us,
        float(np.abs(exact - tight).max()),
        float(np.abs(exact - default).max()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=50)
    repeats = parser.parse_args().repeats
    print("python -m bench.twin")
    print(f"python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}, "
          f"{platform.machine()}; steps of 60 s, {HORIZON} steps a sequence")  # fmt: skip
    batches = " | ".join(f"exact, batch of {batch} [us/step]" for batch in BATCHES)
    print(f"\n| twin | RK45 [us/step] | {batches} | ratio at {BATCHES[-1]} "
          "| off RK45 at 1e-10 [K] | off RK45 at scipy's defaults [K] |")  # fmt: skip
    print("|---|" + "---|" * (len(BATCHES) + 4))
    for name, effects in TWINS.items():
        print(f"| {name} | {measure(effects, repeats)} |")


if __name__ == "__main__":
    main()
