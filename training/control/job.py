"""One run of the comparison, where it is kept, and all of them side by side."""

import hashlib
import json
import re
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from edge.bundle.sign import POLICY_FILES
from edge.bundle.store import PACKAGED_FOLDER
from edge.config.settings import ControlSettings, LlmSettings
from edge.controllers.input_profile import InputProfile
from edge.controllers.mpc_bfgs import MpcBfgs
from edge.controllers.mpc_twin import CLASH_WEIGHT
from edge.controllers.rules import Rules
from edge.core.controller import Controller
from edge.core.controller_names import LLM
from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.core.sweep import sweep
from edge.formats.atomic_file import write_atomically
from edge.formats.profile_file import Profile, read_profile
from edge.models.arx_file import read_arx
from edge.tick.reference import reference_from_profile
from firmware_protocol.virtual_board.chamber_parameters import load
from training.control.chamber_rows import ChamberRows
from training.control.clairvoyant import ReferenceCourse, best_plan, held_plan
from training.control.closed_loop import ClosedLoopLog, closed_loop, log_of
from training.control.draw_references import FOLDER
from training.control.rig import NO_LLM, TWIN, ComparisonEntry, install_twin, settings_for

SECTIONS = ("control", "estimator", "sensor_health", "safety")  # that a run depends on
FIRST_TICK_S = 1.0  # when the board has greeted and sent its first report


@dataclass(frozen=True, slots=True)
class ComparisonJob:
    """An entry of the table on a reference and a seed of the virtual board; llm : where a model answers"""

    entry: ComparisonEntry
    reference: str
    seed: int
    llm: LlmSettings = NO_LLM

    def __str__(self) -> str:
        return f"{self.entry.name} on {self.reference}, seed {self.seed}"

    @property
    def profile(self) -> Path:
        """The reference's file."""
        return FOLDER / f"{self.reference}.csv"

    def sha256(self) -> str:
        """Return a hash of everything decided beforehand: a run with the same hash is not repeated."""
        settings = settings_for(self.entry, Path(self.profile.name), Path("/"), self.llm)
        facts: dict[str, Any] = {
            "entry": [self.entry.name, self.entry.controller, self.entry.models, self.entry.clairvoyant],
            "unbounded": self.entry.unbounded,
            "settings": [asdict(getattr(settings, section)) for section in SECTIONS],
            "reference": self.profile.read_text(encoding="utf-8"),
            "twin": TWIN.read_text(encoding="utf-8") if self.entry.models == "twin" else "",
            "seed": self.seed,
        }
        if (policy := POLICY_FILES.get(self.entry.controller)) is not None:
            facts["policy"] = hashlib.sha256((PACKAGED_FOLDER / policy).read_bytes()).hexdigest()
        if self.entry.clairvoyant is not None:
            clash_weight = CLASH_WEIGHT if self.entry.rule == "band" else 0.0
            facts["clairvoyant"] = [self.entry.rule, self.entry.whole, clash_weight]
        if self.entry.thresholds is not None:
            facts["thresholds"] = asdict(self.entry.thresholds)
        if settings.llm.model:
            llm = settings.llm  # wherever it runs
            facts["llm"] = [llm.model, llm.exchanges, llm.answer_tokens]
        return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()

    def folder(self, root: Path) -> Path:
        """Return the run's folder."""
        row = self.entry.name if self.entry.controller not in LLM else f"{self.entry.name}_{self.llm.model}"
        return root / self.reference / re.sub(r"[^\w.-]+", "_", row) / f"seed_{self.seed}"


def is_kept(job: ComparisonJob, root: Path) -> bool:
    """Return whether exactly this run is saved."""
    facts = job.folder(root) / "run.json"
    return facts.exists() and json.loads(facts.read_text(encoding="utf-8"))["sha256"] == job.sha256()


def run(job: ComparisonJob) -> ClosedLoopLog:
    """Do it: the daemon and the board in this process, from a cold box at the room's temperature."""
    with tempfile.TemporaryDirectory(prefix="control-") as temporary:
        folder = Path(temporary)
        settings = settings_for(job.entry, job.profile, folder, job.llm)
        if job.entry.models == "twin":
            install_twin(settings.bundle, settings.control.step_s)
        instead = _instead(job)
        with closed_loop(settings, instead, board="here", seed=job.seed, folder=folder) as lab:
            lab.run(minutes=read_profile(job.profile).end_s / 60.0)
        return log_of(lab, instead)


def course_of(job: ComparisonJob) -> ReferenceCourse | None:
    """Return the course of a clairvoyant entry from the first tick on; None
    for one that decides as it goes.
    """
    target = job.entry.clairvoyant
    if target is None:
        return None
    step_s = ControlSettings().step_s
    times = step_s * np.arange(int(read_profile(job.profile).end_s / step_s) - 1, dtype=np.float64)
    reference = reference_from_profile(job.profile).at(times, times)
    weight = float("-P" in job.entry.name)
    course = ReferenceCourse(reference, FIRST_TICK_S, step_s, weight, target, whole=job.entry.whole)
    if job.entry.rule != "band":
        return course
    return replace(course, early_k=ControlSettings().twin_early_k, clash_weight=CLASH_WEIGHT)


def fresh_chamber(job: ComparisonJob) -> ChamberRows:
    """Return the chamber behind the job's board, its future not yet asked."""
    return ChamberRows(*load(), job.seed)


def _instead(job: ComparisonJob) -> Controller | None:
    """Return the controller that the daemon does not have, None for one that it has."""
    if job.entry.unbounded:
        weight = float(job.entry.controller.endswith("-P"))
        return MpcBfgs("unbounded", read_arx(), weight, ControlSettings().horizon, bounded=False)
    if job.entry.thresholds is not None:
        return Rules(job.entry.thresholds, name="tuned")
    return _clairvoyant(job)


def _clairvoyant(job: ComparisonJob) -> Controller | None:
    """Return the best plan as an input profile."""
    course = course_of(job)
    if course is None:
        return None
    find = held_plan if job.entry.rule == "present" else best_plan
    plan = find(lambda: fresh_chamber(job), course)
    columns = {
        "time_s": course.step_s * np.arange(len(course.reference) + 1),
        "heater_duty": np.append(plan.levels / HEATER_LEVELS, 0.0),
        "fan_on": np.append(plan.fan, 0.0),
    }
    return InputProfile(Profile(columns, Path("plan")))


def keep(job: ComparisonJob, log: ClosedLoopLog, root: Path) -> None:
    """Columns as columns.npz, what was counted as run.json; the latter last, so that a kill leaves no run."""
    folder = job.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").unlink(missing_ok=True)
    columns: dict[str, Any] = {key: np.asarray(values) for key, values in log.columns.items()}
    np.savez_compressed(folder / "columns.npz", **columns)
    facts: dict[str, Any] = {
        "sha256": job.sha256(),
        "entry": job.entry.name,
        "reference": job.reference,
        "seed": job.seed,
        "changes": dict(log.changes),
        "instead": dict(log.instead),
        "time_boxes": log.time_boxes,
        "asked": dict(log.asked),
    }
    write_atomically(folder / "run.json", json.dumps(facts, indent=1) + "\n")


def read(job: ComparisonJob, root: Path) -> ClosedLoopLog:
    """Read a saved run. Errors: DataError where it is missing, or another one is there"""
    if not is_kept(job, root):
        raise DataError(
            f"{job.folder(root)}: no such run with these settings: run `greenhouse-train compare`"
        )
    folder = job.folder(root)
    facts = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    with np.load(folder / "columns.npz") as columns:
        return ClosedLoopLog(
            {key: columns[key] for key in columns.files},
            Counter(facts["changes"]),
            Counter(facts["instead"]),
            facts["time_boxes"],
            asked=Counter(facts.get("asked", {})),
        )


def run_all(jobs: Sequence[ComparisonJob], root: Path, workers: int, dask: str | None = None) -> None:
    """Do and keep those that are missing. Errors: SweepError with what a failed run said"""
    waiting = [job for job in jobs if not is_kept(job, root)]

    def tell(done: int, job: ComparisonJob, nothing: None) -> None:
        print(f"{job}: done, {len(waiting) - done} left", flush=True)

    sweep(partial(_do, root.resolve()), waiting, workers, dask, tell)


def _do(root: Path, job: ComparisonJob) -> None:
    keep(job, run(job), root)
