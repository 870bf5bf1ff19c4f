"""python -m bench.make_example_runs: the runs and the twin of docs/examples/diagnosis, about half a minute.

A box whose twin was calibrated when it was new: wall, contents and fan. Since then a seam has opened and a
heavier heater was fitted; the recorded runs know of both, the twin of neither. Runs are recorded by
`greenhouse experiment` on a virtual board: the daemon's loop, its safety, the protocol and the independent
chamber. The same seeds give the same files; --check makes them again and tells which differ.
"""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from bench.foreign.greenhouse import BASE, ChamberDay, Settings, drive
from edge.__main__ import main as greenhouse
from edge.core.errors import GreenhouseError
from edge.formats.number_table import write_table
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.tick.sensor_health import AVERAGE_S
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from firmware_protocol.virtual_board.effects import EFFECT_NAMES

EXAMPLE = Path(__file__).parent.parent / "docs" / "examples" / "diagnosis"
STEP_S, STEP_K, REST_MIN, ROOM_C = 60.0, 0.1, 10, 21.2
COLUMNS = ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
FACTS = ("start_utc", "rig", "role", "seed", "notes")

QUIET: Settings = {
    "effects.power_run_variation": 0.0,
    "effects.power_wander": 0.0,
    "effects.sensor_noise": 0.0,
    "effects.sensor_step": 0.0,
}
NEW_BOX: Settings = {
    "cover.inner_film_w_m2_k": 80.0,  # sheets that let heat through
    "cover.gap_w_m2_k": 150.0,
    "effects.wall_loss": 1.0,
    "cover.outer_film_w_m2_k": 4.0,
    "effects.extra_capacity": 1.0,
    "effects.fan_effectiveness": 1.0,
    "fan.effectiveness": 0.7,
}
SINCE: Settings = {
    "effects.infiltration": 1.0,  # a seam
    "air.leak_flow_m3_s": 0.0015,
    "effects.heater_lag": 1.0,  # a heavier element
    "heater.capacity_j_k": 60.0,
}
CALIBRATED_ON = (91, 92)  # seeds of two quiet runs of the new box
UNSURE = {"fan_effectiveness": 0.02}  # relative standard deviation


@dataclass(frozen=True, slots=True)
class ExampleRecording:
    """A run file: its length, and the seed of its profile and of its virtual board."""

    name: str
    role: str
    minutes: int
    seed: int


RECORDINGS = (
    *(ExampleRecording(f"train_{number}.csv", "train", 120, number) for number in range(1, 5)),
    ExampleRecording("test_1.csv", "test", 150, 5),
)


def make(folder: Path) -> None:
    """Every file of the example. Errors: GreenhouseError"""
    folder.mkdir(parents=True, exist_ok=True)
    chamber = folder / "chamber.yaml"
    chamber.write_text(_chamber_text(), encoding="utf-8")
    (folder / "twin.yaml").write_text(_twin_text(), encoding="utf-8")
    for recording in RECORDINGS:
        _record(recording, chamber, folder / recording.name)


def _chamber_text() -> str:
    return (
        "# The box that the runs were recorded in, for `greenhouse experiment --virtual --chamber`.\n"
        "# No input of the diagnosis: `infiltration` and `heater_lag` are what its twin does not know.\n"
    ) + yaml.safe_dump(chamber_document({**NEW_BOX, **SINCE}), sort_keys=True)


def _twin_text() -> str:
    """Return the twin, calibrated on the box when it was new; readings are
    as late as the mean that they are.
    """
    effects: dict[str, dict[str, object]] = {
        name: {key: _value(name, item.value) for key, item in own.items()}
        for name, own in _calibrate().items()
    }
    late_s = AVERAGE_S / 2.0
    effects |= {"heater_deadtime": {"d_h": late_s}, "fan_deadtime": {"d_f": late_s}}
    document = {
        "sample_s": STEP_S,
        "effects": effects,
        "sensor": {"quantisation_k": STEP_K, "noise_sd_k": None},
        "nuisance": {"heater_power_run_sd": 0.015, "heat_noise_sd_w": None},
    }
    return (
        "# What its owner knows of the box: calibrated when it was new. Both dead times are half of the\n"
        f"# {AVERAGE_S:g} s that a reading is the mean of.\n"
    ) + yaml.safe_dump(document, sort_keys=False)


def _calibrate() -> Mapping[str, Mapping[str, Value]]:
    """Return the effects of the new box: what the chamber has no number for is fitted to its quiet runs."""
    file = TwinFile(
        effects={
            "wall_loss": {"UA": Value(EFFECTS["wall_loss"].parameter("UA").start, fit=True)},
            "extra_capacity": {"kC": Value(BASE["air.contact_capacity_factor"])},
            "fan_effectiveness": {"eps_f": Value(NEW_BOX["fan.effectiveness"])},
        },
        sensor={"quantisation_k": None, "noise_sd_k": 0.02},
    )
    return fit_twin(file, [_quiet_run(seed) for seed in CALIBRATED_ON]).file.effects


def _quiet_run(seed: int) -> RecordedRun:
    """Two hours in which heater and fan switch at random."""
    random = np.random.default_rng(seed)
    duty, fan = np.repeat(random.uniform(0.0, 0.7, 12), 10), np.repeat(random.integers(0, 2, 12), 10)
    day = ChamberDay(hour=10.0, room_c=ROOM_C, light=np.zeros(len(duty)), seed=seed)
    run = drive({**NEW_BOX, **QUIET}, day, lambda k, _: (float(duty[k]), float(fan[k])))
    columns = {name: run[name] for name in COLUMNS if name in run}
    time_s = STEP_S * np.arange(len(duty), dtype=np.float64)
    return RecordedRun({"time_s": time_s, **columns}, {"role": "train"})


def chamber_document(settings: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return a chamber file for the virtual board, whose relay makes the duty: unset effects are off."""
    document: dict[str, dict[str, float]] = {"effects": dict.fromkeys(EFFECT_NAMES, 0.0)}
    for place, value in {**BASE, **settings}.items():
        section, _, key = place.partition(".")
        document.setdefault(section, {})[key] = float(value)
    del document["heater"]["duty_window_s"]  # the board's own
    return document


def _value(effect: str, value: float) -> object:
    rounded = float(f"{value:.3g}")
    return {"value": rounded, "rel_sd": UNSURE[effect]} if effect in UNSURE else rounded


def _record(recording: ExampleRecording, chamber: Path, path: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="greenhouse-example-") as temporary:
        profile, raw = Path(temporary) / "profile.csv", Path(temporary) / path.name
        write_table(profile, _profile(recording), {})
        words = ["experiment", profile, "--out", raw, "--role", recording.role]
        words += ["--virtual", "--seed", recording.seed, "--chamber", chamber]
        if greenhouse([str(word) for word in words]) != 0:
            raise GreenhouseError(f"{path}: greenhouse experiment failed")
        run = read_run(raw)
    columns = {name: run.columns[name] for name in COLUMNS}
    columns |= {name: np.round(columns[name], 1) for name in ("temp_air_c", "temp_ambient_c")}
    facts = {key: run.facts[key] for key in FACTS if key in run.facts}
    write_run(replace(run, columns=columns, facts=facts), path)


def _profile(recording: ExampleRecording) -> Mapping[str, np.ndarray]:
    """Return a rest, until the whole box is as warm as the room; then random switches of heater and fan."""
    random = np.random.default_rng(recording.seed)
    duty = _hold(random, recording.minutes, (8, 25), (0.0, 0.15, 0.3, 0.45, 0.6))
    fan = _hold(random, recording.minutes, (5, 30), (0.0, 0.0, 1.0))
    duty[:REST_MIN] = fan[:REST_MIN] = 0.0
    time_s = STEP_S * np.arange(recording.minutes + 1)
    return {"time_s": time_s, "heater_duty": np.append(duty, 0.0), "fan_on": np.append(fan, 0.0)}


def _hold(
    random: np.random.Generator, minutes: int, lengths: tuple[int, int], levels: Sequence[float]
) -> np.ndarray:
    """Draw a level a minute; each holds for some minutes and differs from the one before if possible."""
    values: list[float] = []
    while len(values) < minutes:
        values += [float(random.choice(levels))] * int(random.integers(lengths[0], lengths[1] + 1))
    return np.array(values[:minutes])


def _differing(folder: Path) -> list[str]:
    """Names of the files that are not made again as they are."""
    with tempfile.TemporaryDirectory(prefix="greenhouse-example-") as temporary:
        again = Path(temporary)
        make(again)
        return [
            path.name
            for path in sorted(again.iterdir())
            if not (folder / path.name).is_file() or (folder / path.name).read_bytes() != path.read_bytes()
        ]


def main(words: Sequence[str] | None = None) -> int:
    """0; with --check 1 where a file differs."""
    parser = argparse.ArgumentParser(prog="python -m bench.make_example_runs", description=__doc__)
    parser.add_argument("--out", type=Path, default=EXAMPLE, help="folder; default: docs/examples/diagnosis")
    parser.add_argument("--check", action="store_true", help="change nothing, tell what would differ")
    arguments = parser.parse_args(words)
    if not arguments.check:
        make(arguments.out)
        return 0
    differing = _differing(arguments.out)
    print("\n".join(f"differs: {name}" for name in differing) or "all as they are made")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
