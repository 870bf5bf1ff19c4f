"""python -m bench.resolve_alias: an alias class resolved by its own proposed experiment, end to end.

A virtual rig whose box lacks something that its first runs can't name for certain: a leak in runs in which
the fan never runs; a heater that gives no more than half its power in runs that know one duty. Recorded by
`greenhouse experiment`, diagnosed by `greenhouse twin diagnose`; then the experiment which that proposes is
run on the same rig, through the daemon's loop and safety, and all runs are diagnosed again.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.hidden_effects.chamber_box import BASE, LEAD_ROWS, THIN_WALLS, RunPlan, Settings, calibrate
from edge.formats.number_table import write_table
from edge.tick.sensor_health import AVERAGE_S
from edge.twin.twin_file import TwinFile, write_twin_file
from edge.twin.value import Value
from firmware_protocol.virtual_board.effects import EFFECT_NAMES

STEP_S, ROOM_C = 60.0, 21.2
GREENHOUSE = (sys.executable, "-m", "edge")
Columns = tuple[np.ndarray[Any, np.dtype[np.float64]], np.ndarray[Any, np.dtype[np.float64]]]


@dataclass(frozen=True, slots=True)
class AliasCase:
    """A box, what of it the twin knows, and what the first runs do.

    box : settings of the chamber without what is hidden; hidden : the effect, and its settings
    profile : duty and fan of each first run, a value a row; seeds : of the virtual boards, the last one for
        the experiment
    """

    title: str
    known: tuple[str, ...]
    box: Settings
    hidden: str
    settings: Settings
    profile: Columns
    seeds: tuple[int, ...]


def _stairs(levels: Sequence[float], rows: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.repeat(np.array(levels, dtype=np.float64), rows)


ELEMENT: Settings = {"effects.heater_lag": 1.0, "heater.capacity_j_k": 40.0}  # evens out the relay's windows
_CASES = (
    AliasCase(
        "a leak, in runs in which the fan never runs",
        ("longwave_radiation", "extra_capacity", "heater_lag"),
        {
            **THIN_WALLS,
            **ELEMENT,
            "cover.outer_film_w_m2_k": 3.0,
            "effects.longwave_radiation": 0.6,
            "effects.extra_capacity": 1.0,
        },
        "infiltration",
        {"effects.infiltration": 1.0, "air.leak_flow_m3_s": 0.0015},
        (_stairs([0.1, 0.45, 0.0, 0.35, 0.6, 0.2], 25), np.zeros(150)),
        (1, 2, 3, 11),
    ),
    AliasCase(
        "a heater that gives half its power at most, in runs that know one duty",
        ("wall_loss", "extra_capacity", "heater_lag"),
        {
            **THIN_WALLS,
            **ELEMENT,
            "cover.outer_film_w_m2_k": 4.0,
            "effects.wall_loss": 1.0,
            "effects.extra_capacity": 1.0,
        },
        "heater_saturation",
        {"effects.heater_saturation": 1.0, "heater.saturation_duty": 0.5},
        (_stairs([0.0, 0.7, 0.0, 0.7, 0.0], 30), _stairs([0.0, 1.0] * 5, 15)),
        (4, 5, 6, 12),
    ),
)
CASES: Mapping[str, AliasCase] = {case.hidden: case for case in _CASES}


def twin_of(case: AliasCase, late_s: float = 0.0) -> TwinFile:
    """Return the known twin of the box, calibrated on quiet runs of one in which nothing is hidden.

    late_s : by which readings are older than the rows they stand in
    """
    known = calibrate(case.known, case.box, [quiet_plan(seed) for seed in (91, 92)]).effects
    late = {"heater_deadtime": {"d_h": late_s}, "fan_deadtime": {"d_f": late_s}} if late_s else {}
    return TwinFile(
        effects={
            name: {key: Value(float(f"{value:.5g}")) for key, value in own.items()}
            for name, own in {**known, **late}.items()
        },
        sensor={"quantisation_k": 0.1, "noise_sd_k": None},
        nuisance={"heater_power_run_sd": 0.015, "heat_noise_sd_w": 1.0},
    )


def quiet_plan(seed: int) -> RunPlan:
    """Two hours in which heater and fan switch at random, to calibrate a twin on."""
    random = np.random.default_rng(seed)
    duty, fan = np.repeat(random.uniform(0.0, 0.7, 12), 10), np.repeat(random.integers(0, 2, 12), 10)
    before = np.zeros(LEAD_ROWS)
    return RunPlan(
        np.concatenate([before, duty]),
        np.concatenate([before, fan.astype(np.float64)]),
        np.zeros(LEAD_ROWS + len(duty)),
        day=0.0,
        hour=10.0,
        room_c=ROOM_C,
        seed=seed,
    )


def chamber_document(settings: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return a chamber file for the virtual board, whose relay makes the duty: unset effects are off."""
    document: dict[str, dict[str, float]] = {"effects": dict.fromkeys(EFFECT_NAMES, 0.0)}
    for place, value in {**BASE, **settings}.items():
        section, _, key = place.partition(".")
        document.setdefault(section, {})[key] = float(value)
    del document["heater"]["duty_window_s"]  # the board's own
    return document


def resolve(case: AliasCase, folder: Path) -> list[str]:
    """Run the whole chain; return lines of the table."""
    twin, chamber = folder / "twin.yaml", folder / "chamber.yaml"
    write_twin_file(twin_of(case, AVERAGE_S / 2.0), twin)  # a reading is the mean of the seconds before it
    chamber.write_text(yaml.safe_dump(chamber_document({**case.box, **case.settings})), encoding="utf-8")
    profile = folder / "first.csv"
    _write_profile(profile, case.profile)
    runs = [folder / f"run_{seed}.csv" for seed in case.seeds]
    for seed, run in zip(case.seeds[:-1], runs, strict=False):
        _experiment(profile, run, chamber, seed)
    before = _diagnosis(runs[:-1], twin, folder / "before")
    lines = [f"## {case.title}", f"  truth: {case.hidden} {case.settings}", *_answer_lines("before", before)]
    experiment = before["next_experiment"]
    if not experiment or "profile" not in experiment:
        return [*lines, "  no experiment is proposed"]
    lines.append(f"  proposed: {experiment['why']}")
    lines.append(
        f"  run: {_experiment(folder / 'before' / experiment['profile'], runs[-1], chamber, case.seeds[-1])}"
    )
    after = _diagnosis(runs, twin, folder / "after")
    return [*lines, *_answer_lines("after", after), *_resolution(case, before, after)]


def _write_profile(path: Path, profile: Columns) -> None:
    duty, fan = (np.append(column, 0.0) for column in profile)
    columns = {"time_s": STEP_S * np.arange(len(duty)), "heater_duty": duty, "fan_on": fan}
    write_table(path, columns, {})


def _experiment(profile: Path, run: Path, chamber: Path, seed: int) -> str:
    words = ("experiment", profile, "--out", run, "--virtual", "--chamber", chamber, "--seed", seed)
    return _greenhouse(*words, "--role", "train").strip().splitlines()[-1].rpartition("/")[2]


def _diagnosis(runs: Sequence[Path], twin: Path, report: Path) -> dict[str, Any]:
    _greenhouse("twin", "diagnose", *runs, "--twin", twin, "--out", report, "--json-only")
    return dict(json.loads((report / "diagnosis.json").read_text(encoding="utf-8")))


def _greenhouse(*words: object) -> str:
    """Return the output of `greenhouse`. Errors: RuntimeError with its messages"""
    done = subprocess.run([*GREENHOUSE, *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"greenhouse {words[0]}: {done.stdout}{done.stderr}")
    return done.stdout


def _answer_lines(when: str, found: Mapping[str, Any]) -> list[str]:
    lines = [f"  {when}: {found['verdict']}"]
    for effect in found["effects"]:
        values = ", ".join(
            f"{name} {item['value']:.4g} ({item['low']:.4g} to {item['high']:.4g}) {item['unit']}".rstrip()
            for name, item in effect["parameters"].items()
        )
        rivals = effect["alternative_log_odds"]
        told = ", ".join(f"{name} ({value:+.2f} nat)" for name, value in rivals.items()) or "none"
        lines.append(f"    {effect['name']}: {values}; can't be told from: {told}")
    return lines


def _resolution(case: AliasCase, before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return whether the class is resolved, and to which effect."""
    names = [effect["name"] for effect in after["effects"]]
    left = [name for effect in after["effects"] for name in effect["alternatives"]]
    first = [effect["name"] for effect in before["effects"]]
    first += [name for effect in before["effects"] for name in effect["alternatives"]]
    resolved = names == [case.hidden] and not left and len(first) > 1
    return [f"  class of {len(first)}: {'resolved to the true one' if resolved else 'NOT resolved'}"]


def main(words: Sequence[str] | None = None) -> int:
    """Resolve the cases named, or all; 1 if a class was not resolved."""
    parser = argparse.ArgumentParser(prog="python -m bench.resolve_alias", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}")
    parser.add_argument("--keep", type=Path, help="folder for runs and reports, else they are thrown away")
    arguments = parser.parse_args(words)
    if unknown := [name for name in arguments.names if name not in CASES]:
        parser.error(f"there is no {unknown[0]!r}; there are {', '.join(CASES)}")
    failed = False
    for name in arguments.names or CASES:
        with tempfile.TemporaryDirectory(prefix="greenhouse-resolve-") as temporary:
            folder = Path(temporary) if arguments.keep is None else arguments.keep / name
            folder.mkdir(parents=True, exist_ok=True)
            begun = time.monotonic()
            lines = resolve(CASES[name], folder)
            print(*lines, f"  took {time.monotonic() - begun:.0f} s", "", sep="\n", flush=True)
            failed |= "NOT" in lines[-1] or "no experiment" in lines[-1]
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
