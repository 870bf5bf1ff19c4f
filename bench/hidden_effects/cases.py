"""Cases: runs and a twin file that the workflow is given, and the truth that it is not.

Files, under the root of all suites:

    <suite>/<split>/cases/<id>/train_01.csv ... test_01.csv ... twin.yaml
    <suite>/<split>/truth/<id>.json, <id>_test_01.csv ..., <id>_true_twin.yaml (of the suite `equations`)

A test run's temperatures are given in its first GIVEN_ROWS rows. In the truth they stand whole, with the
column `temp_clean_c`: what a sensor without noise and steps would show, disturbances included.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from edge.formats.run_file import RecordedRun
from edge.twin.twin_file import TwinFile

GENERATOR_VERSION = 3  # cases of another version are made anew
GIVEN_ROWS = 2
STEP_S = 60.0
SUITES = ("equations", "chamber")
FIRST_SEEDS = {"dev": 0, "scored": 100_000}  # so that no case of one split is in the other
SEEDS_PER_KIND = 1000
SIZES_K = {
    "null": (0.0, 0.0), "single": (0.4, 3.0), "pair": (0.4, 3.0), "outside": (0.5, 3.0), "weak": (0.1, 0.3),
    "hard": (0.5, 3.0), "bare": (0.25, math.inf),
}  # fmt: skip
KINDS = {"null": 100, "single": 100, "pair": 50, "outside": 40, "weak": 25, "hard": 25, "bare": 25}
DEPENDENCES = ("heater_duty", "fan_on", "temp_air", "temp_ambient", "light", "rel_humidity", "time", "none")


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """An effect that the twin file does not have, and what the noise-free temperature does without it.

    parameters : by name, in the library's units; empty where the truth is not the library's equation
    size_k : root mean square over all runs
    """

    name: str
    parameters: Mapping[str, float]
    size_k: float


@dataclass(frozen=True, slots=True)
class RunTruth:
    """The truth of a test run. Lists of one number per row.

    measured_c : as the sensor shows it, with noise and steps; None where a reading is missing
    clean_c : without noise and steps, but with the heat noise and the mains of that run
    undisturbed_c : without those as well, and the door closed: what the true equations forecast
    start : true states at the first row, by name [°C, the heater in W]
    """

    measured_c: list[float | None]
    clean_c: list[float]
    undisturbed_c: list[float]
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Truth:
    """The answer to a case.

    hidden : most important first; empty for kinds null and outside
    outside : the effect that no library knows, None where there is none
    depends_on : words of DEPENDENCES that describe the outside effect, strongest first
    known : effects that twin.yaml declares
    effects : all true parameters in the library's terms, hidden ones included, as far as they exist
    noise : sensor noise sd [K], step [K], sd of heat [W] and others, by name
    """

    id: str
    suite: str
    split: str
    kind: str
    seed: int
    hidden: tuple[HiddenEffect, ...]
    outside: HiddenEffect | None
    depends_on: tuple[str, ...]
    known: tuple[str, ...]
    effects: Mapping[str, Mapping[str, float]]
    noise: Mapping[str, float]
    tests: Mapping[str, RunTruth]
    generator_version: int = GENERATOR_VERSION

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class HiddenCase:
    """All of a case. train, test : whole runs by file name; true_twin : None where none is true."""

    truth: Truth
    twin: TwinFile
    train: Mapping[str, RecordedRun]
    test: Mapping[str, RecordedRun]
    true_twin: TwinFile | None


def seed_of(split: str, kind: str, number: int) -> int:
    """Seed of a split's case, `number` from 0 within its kind. Errors: ValueError for a number above."""
    if not 0 <= number < SEEDS_PER_KIND:
        raise ValueError(f"{kind}: case {number} is not in 0..{SEEDS_PER_KIND - 1}")
    return FIRST_SEEDS[split] + SEEDS_PER_KIND * list(KINDS).index(kind) + number


def case_id(seed: int) -> str:
    """Name of a case within its suite and split; it does not tell the kind."""
    return f"case_{seed:06}"
