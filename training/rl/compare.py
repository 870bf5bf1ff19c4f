"""Learning algorithms side by side: kept policies in fresh episodes of their model, and on the virtual rig.

All learn for the same reward from the same observation with as many steps. A policy of seed s drives the
board of seed s + 1 along the reference, by the whole daemon. Regret is by the cheapest plan or run that knows
no more of the reference than a policy, of the figures that `greenhouse-train compare` has saved. Nothing is
chosen here.
"""

import json
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.table import Table
from edge.models.onnx_policy import read_policy
from training.control.comparison import Results, RunResult, read_results, regret, spread_text
from training.control.figures import Figures, decision_time, figures, mean_of
from training.control.job import ComparisonJob, run_all
from training.control.job import read as read_run
from training.control.rig import ComparisonEntry, entries
from training.evaluate.evaluation import machine
from training.rl.boxes import World
from training.rl.gap import act_of
from training.rl.saved_policy import POLICY_FILE, Record, read_record
from training.rl.study import play

JUDGED, JUDGED_SEED = 256, 30_001  # episodes in which nothing was tuned or chosen
REFERENCE = "reference_1"
VARIANT, PLANNER = "RL-Off", "MPC-Twin/present"  # without penalty, both
JSON_FILE, TEXT_FILE = "algorithms.json", "algorithms.txt"


@dataclass(frozen=True, slots=True)
class AlgorithmFigures:
    """Figures of one policy, or of the planner beside them, which has no training.

    model_cost : of a step, the reward with its sign turned; model_mae_k, rig_mae_k : by the true air
    rig_mae_sensor_k : by the sensor; regret : tracking cost at the sensor by the least of equal knowledge
    decision_ms : median of the rig's run; train_cpu_s : on the machine of the training
    """

    algorithm: str
    seed: int
    model_cost: float | None
    model_mae_k: float | None
    rig_mae_k: float
    rig_mae_sensor_k: float
    regret: float
    decision_ms: float
    train_cpu_s: float | None
    onnx_bytes: int | None
    policy: str = ""
    command: str = ""


@dataclass(frozen=True, slots=True)
class JudgedPolicy:
    """A saved policy of an algorithm."""

    algorithm: str
    folder: Path

    @property
    def file(self) -> Path:
        """File that a rig runs."""
        return self.folder / POLICY_FILE

    def job(self, record: Record) -> ComparisonJob:
        """Return its run on the rig."""
        name = f"{VARIANT}/{self.algorithm}/{record['seed']}"
        return ComparisonJob(ComparisonEntry(name, VARIANT, policy=self.file), REFERENCE, record["seed"] + 1)


def compare(
    policies: Sequence[JudgedPolicy], world: World, runs: Path, kept: Path
) -> Iterator[AlgorithmFigures]:
    """Yield the figures of each policy, then those of the planner on the same boards.

    runs : folder of runs on the rig, done before and now; kept : folder of the comparison's figures
    Errors : DataError for a training of other steps than the others', or where a fallback drove the rig
    """
    known = read_results(kept)
    records = [read_record(one.folder) for one in policies]
    if len(steps := {record["settings"]["steps"] for record in records}) > 1:
        raise DataError(f"trainings of {sorted(steps)} steps: all need the same number")
    for one, record in zip(policies, records, strict=True):
        policy = read_policy(one.file, VARIANT)
        played = play(act_of(policy), world, JUDGED, JUDGED_SEED)
        yield AlgorithmFigures(
            algorithm=one.algorithm,
            seed=record["seed"],
            model_cost=-played.reward,
            model_mae_k=played.mae_k,
            **_on_rig(one.job(record), VARIANT, runs, known),
            train_cpu_s=record["cpu_s"],
            onnx_bytes=one.file.stat().st_size,
            policy=policy.version,
            command=record["command"],
        )
    for seed in sorted({record["seed"] for record in records}):
        job = ComparisonJob(entries()[PLANNER], REFERENCE, seed + 1)
        rig = _on_rig(job, PLANNER, runs, known)
        yield AlgorithmFigures(
            PLANNER, seed, model_cost=None, model_mae_k=None, **rig, train_cpu_s=None, onnx_bytes=None
        )


def _on_rig(job: ComparisonJob, like: str, runs: Path, known: Results) -> dict[str, Any]:
    """Return the figures on the rig. like : entry of the comparison that knows as much, and gives way here"""
    run_all([job], runs, workers=0)
    log = read_run(job, runs)
    if log.instead:
        raise DataError(
            f"{job}: a fallback drove the rig: {dict(log.instead)}: delete {job.folder(runs)} and run again"
        )
    found = figures(log)
    return {
        "rig_mae_k": found.mae_true,
        "rig_mae_sensor_k": found.mae_measured,
        "regret": regret_of(found, job.seed, like, known),
        "decision_ms": decision_time(log).median_ms,
    }


def regret_of(found: Figures, seed: int, like: str, known: Results) -> float:
    """Return the cost at the sensor by the least of all runs on this board that know no more than `like`."""
    others = [one for one in known if one.seed == seed and one.entry != like]
    mean = regret([*others, RunResult(like, REFERENCE, seed, found)], like, REFERENCE, True, True)
    if mean is None:
        raise DataError(f"board {seed}: no clairvoyant is kept for {REFERENCE}")
    return mean.value


COLUMNS: Mapping[str, tuple[str, int]] = {  # heading -> figure, digits
    "model cost": ("model_cost", 3), "model MAE": ("model_mae_k", 3), "rig MAE": ("rig_mae_k", 3),
    "by sensor": ("rig_mae_sensor_k", 3), "x equal": ("regret", 2), "decision ms": ("decision_ms", 2),
    "train CPU s": ("train_cpu_s", 1), "ONNX kB": ("onnx_bytes", 0),
}  # fmt: skip
NOTE = (
    "Means of the seeds +- half of their 95 % interval, then seed by seed. model: true air in 256 "
    "fresh episodes, cost of a step 0.5 e^2 + |e|. rig: reference_1, board of the policy's seed + 1, MAE "
    "by true air and sensor [K]. x equal: tracking cost at the sensor by that of the cheapest plan or run on "
    "this board that knows the present reference alone. decision: median wall clock of the rig's decisions."
)


def table(found: Sequence[AlgorithmFigures]) -> Table:
    """Return a line for each algorithm, then one for each policy."""
    names = list(dict.fromkeys(one.algorithm for one in found))
    groups = [[one for one in found if one.algorithm == name] for name in names]
    rows = [(group[0].algorithm, f"all {len(group)}", *_cells(group)) for group in groups]
    rows += [(one.algorithm, str(one.seed), *_cells([one])) for one in found]
    return Table("", ("algorithm", "seed", *COLUMNS), tuple(rows), NOTE)


def _cells(group: Sequence[AlgorithmFigures]) -> Iterator[str]:
    for name, digits in COLUMNS.values():
        values = [getattr(one, name) for one in group if getattr(one, name) is not None]
        scale = 1000.0 if name == "onnx_bytes" else 1.0
        yield spread_text(mean_of([value / scale for value in values]), digits) if values else "-"


def head(command: str, world: World) -> list[str]:
    """Return the lines above the table: command, code, machine, model, episodes."""
    told = ("git", "describe", "--always", "--abbrev=12", "--dirty", "--exclude=*")
    done = subprocess.run(told, capture_output=True, text=True, check=False)
    return [
        command,
        f"commit {done.stdout.strip() or 'unknown'}; {machine()['cpu']}, a shared machine",
        f"{VARIANT}; model {world.model.name} {world.model.sha256[:12]}; "
        f"{JUDGED} episodes of seed {JUDGED_SEED}",
    ]


def text_of(found: Sequence[AlgorithmFigures], head: Sequence[str]) -> str:
    """Return the table under its head, and the policies that it is about."""
    names = dict.fromkeys(one.algorithm for one in found)
    times = {name: [one.decision_ms for one in found if one.algorithm == name] for name in names}
    planner = mean_of(times[PLANNER]).value
    ratios = [
        f"# {name} decides in 1/{planner / mean_of(own).value:.0f} of the time of {PLANNER}"
        for name, own in times.items()
        if name != PLANNER
    ]
    files = [f"# {one.algorithm} {one.seed} {one.policy}: {one.command}" for one in found if one.policy]
    return "\n".join([*(f"# {line}" for line in head), *table(found).text(), *ratios, *files]) + "\n"


def json_of(found: Sequence[AlgorithmFigures]) -> str:
    """Return all digits, a policy on each line."""
    return "[\n" + ",\n".join(json.dumps(asdict(one)) for one in found) + "\n]\n"


def write(found: Sequence[AlgorithmFigures], head: Sequence[str], folder: Path) -> None:
    """Write both files. Errors: OSError"""
    write_atomically(folder / JSON_FILE, json_of(found))
    write_atomically(folder / TEXT_FILE, text_of(found, head))
