"""python -m bench.boxes: boxes commissioned from nothing, then held to a reference by rules, PID, MPC, twin.

The cost is the paper's, 10 e² a step and the effort, but with the error at every 5 s, so that what happens
between two ticks counts. PID is tuned on the twin of the same tests (tuned_pid.py). The paper's MPC has its
bounds. Rows without /early keep to the reference until it changes: the MPCs plan for the present one, and
MPC-Twin-P and the clairvoyant leave it by at most `control.twin_early_k` before a step. Rows with /early know
the coming reference and may leave the present one as they like.
"""

import argparse
import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.boxes.box import Box
from bench.boxes.clairvoyant import Clairvoyant, tune_pid
from bench.boxes.draw import LOTS, draw_box, rise_after_k, scaled_reference
from bench.boxes.facts import BoxFacts
from bench.header import header
from edge.app.commission import Commissioned, learn
from edge.app.step_test_record import record, test_settings
from edge.board.virtual_rig import settings_in
from edge.bundle.archive import open_archive
from edge.bundle.predictors import loader
from edge.bundle.roles import activate
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key
from edge.bundle.store import BundleStore
from edge.config.settings import BoxSettings, ControlSettings, DriftSettings, ReferenceSettings, Settings
from edge.core.controller import Controller
from edge.core.errors import GreenhouseError
from edge.formats.profile_file import read_profile
from edge.models.arx_file import write_arx
from edge.models.pbm import Pbm
from edge.tick.reference import reference_from_profile
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from firmware_protocol.virtual_board.plant import Plant
from training.control.draw_references import FOLDER
from training.control.figures import cycles, left_k
from training.lab import InProcessBoard, Lab

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
ROLES = {"none": "none", "stir": "stirring", "exchange": "exhaust"}
EARLY = "/early"  # after a name: may leave the reference before a step of it
CLAIRVOYANT = "clairvoyant"
PLANNING = ("MPC-P", "MPC-BFGS-P", "MPC-Twin-P", CLAIRVOYANT)
ROWS = ("rules", "PID", *PLANNING, *(f"{name}{EARLY}" for name in PLANNING))
OF_TWIN = "MPC-Twin-P"
OVER_ARX = ("MPC-P", "MPC-BFGS-P")
TUNING = ("tuning_1", "tuning_2", "tuning_3")
ANY_K = 20.0
SAMPLE_S, STEP_S = 5.0, 60.0
EXCURSION_MIN = 15  # before a step of the reference
WARM_UP_S = 600.0  # that no controller can help


class WatchedBox(Box):
    """A box that keeps what its sensor would show without noise and steps."""

    def __init__(self, facts: BoxFacts, seed: int) -> None:
        super().__init__(facts, seed)
        self.seen: list[tuple[float, float]] = []

    def step(self, dt_s: float, heater_power_fraction: float, fan: bool, led: float, valve: bool) -> None:
        """As `Box.step`."""
        super().step(dt_s, heater_power_fraction, fan, led, valve)
        if not self.seen or self.time_s - self.seen[-1][0] >= SAMPLE_S - 1e-6:
            self.seen.append((self.time_s, float(self.physics.reading_c(self.state)[0])))


@dataclass(frozen=True, slots=True)
class BoxRow:
    """A run.

    before_k : how far it left the reference, at most, towards a step of it that was still to come
    cycles : starts of the fan within ten minutes of the last one, with half of full heat in between, where
        no step of the reference asks for it
    """

    controller: str
    cost: float
    mae_k: float
    before_k: float
    fan_starts: int
    cycles: int
    heat_wh: float


def description(facts: BoxFacts) -> TwinFile:
    """Return what a person would say of a box: volume, heater, fan."""
    role = ROLES[facts.fan]
    flow = 3600.0 * facts.fan_m3_s if role == "exhaust" else None
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "box.yaml"
        path.write_text(text(BoxDescription(facts.volume_m3, facts.heater_w, role, flow)))
        return read_twin_file(path)


def rig_settings(folder: Path, twin: TwinFile) -> Settings:
    """Return the daemon's settings in `folder` for a box with this twin."""
    path = folder / "box.yaml"
    path.unlink(missing_ok=True)
    write_twin_file(twin, path)
    rig = settings_in(folder, Settings(timezone="UTC"))
    safety = replace(rig.safety, energy_hour_max_wh=400.0, energy_day_max_wh=9600.0)
    return replace(rig, box=BoxSettings(str(path)), safety=safety, drift=DriftSettings(enabled=False))


def commission(facts: BoxFacts, seed: int, minutes: float) -> Commissioned:
    """Commission a box from its description. Errors: GreenhouseError"""
    start = description(facts)
    with tempfile.TemporaryDirectory(prefix="boxes-") as temporary:
        box = Box(facts, seed)
        board = InProcessBoard(seed, plant=Plant(box, box.parts()))
        settings = test_settings(rig_settings(Path(temporary), start))
        run = record(settings, board, start.fan_role != "none", minutes, open_port=board.open)
    return learn(run, start, ControlSettings(), lambda text, share: None)


def drive(facts: BoxFacts, seed: int, name: str, found: Commissioned, reference: str) -> BoxRow:
    """Hold a box to a scaled reference. name : of ROWS"""
    base, is_early = name.removesuffix(EARLY), name.endswith(EARLY)
    with tempfile.TemporaryDirectory(prefix="boxes-") as temporary:
        folder = Path(temporary)
        path = box_reference(facts, reference, folder)
        settings = rig_settings(folder, found.twin)
        early_k = ANY_K if is_early else settings.control.twin_early_k
        control = replace(
            settings.control,
            controller=base if base in PLANNING and base != CLAIRVOYANT else "rules",
            twin_early_k=early_k,
            preview=is_early,
            time_box_ms=60_000.0,
        )
        settings = replace(
            settings, control=control, reference=ReferenceSettings(kind="csv", csv=str(path), min_c=5.0)
        )
        install(found, settings, folder)
        box = WatchedBox(facts, seed + 1000)
        instead: list[Controller] = []
        if base == "PID":
            cools = facts.fan == "exchange"
            courses = tuning_courses(facts, folder)
            known = facts.room_sensor is not None
            room_c = found.expectation.room_c if known else settings.control.ambient_default_c
            instead = [tune_pid(found.twin.twin(), room_c, courses, cools)]
        if base == CLAIRVOYANT:
            instead = [Clairvoyant(box, Pbm(found.twin.twin()), control.penalty_weight, True, early_k)]
        more: dict[str, Any] = {"more_controllers": instead, "experiment": instead[0].name} if instead else {}
        lab = Lab(settings, board="here", plant=Plant(box, box.parts()), seed=seed, folder=folder, **more)
        with lab:
            lab.run(minutes=read_profile(path).end_s / 60.0)
        return _row(name, lab, np.array(box.seen), facts.heater_w)


def _row(name: str, lab: Lab, seen: Floats, heater_w: float) -> BoxRow:
    ticks = np.array([record.time_s for record in lab.history])
    reference = np.array([record.reference_c for record in lab.history])
    duty = np.array([record.sent.heater_duty for record in lab.history])
    fan = np.array([record.sent.fan for record in lab.history])
    place = np.searchsorted(ticks, seen[:, 0], side="right") - 1
    known = (place >= 0) & (seen[:, 0] > ticks[0] + WARM_UP_S)
    # A step of the reference is due at the end of its step.
    error = np.where(known, seen[:, 1] - reference[np.maximum(place, 0)], 0.0)[known]
    steps = np.flatnonzero(np.abs(np.diff(reference)) > 1.0) + 1
    now = place[known]
    before = [
        left_k(np.sign(reference[k] - reference[k - 1]) * error[_is_before(now, k)])
        for k in steps.tolist()
        if ticks[k] > ticks[0] + WARM_UP_S + 60.0 * EXCURSION_MIN
    ]
    per_step = 10.0 * error**2 * SAMPLE_S / STEP_S
    starts = np.flatnonzero((fan > 0.0) & ~(np.append(0.0, fan[:-1]) >= 1.0))
    return BoxRow(
        name,
        float(per_step.sum() + (duty**2).sum() + fan.sum()),
        float(np.abs(error).mean()),
        max(before, default=0.0),
        len(starts),
        cycles(duty, fan, reference),
        float(duty.sum()) * heater_w * STEP_S / 3600.0,
    )


def box_reference(facts: BoxFacts, name: str, folder: Path) -> Path:
    """Write a reference scaled to what the box can reach, of that name, in `folder`."""
    profile = read_profile(FOLDER / f"{name}.csv")
    course = profile.columns["reference_c"]
    scaled = scaled_reference((course - course.min()) / (course.max() - course.min()), facts)
    path = folder / f"{name}.csv"
    rows = zip(profile.columns["time_s"], scaled, strict=True)
    path.write_text(
        "\n".join(["time_s,reference_c", *(f"{time:g},{value:.3f}" for time, value in rows)]) + "\n"
    )
    return path


def _is_before(place: Ints, k: int) -> NDArray[np.bool_]:
    return np.asarray((place >= k - EXCURSION_MIN) & (place < k))


def tuning_courses(facts: BoxFacts, folder: Path) -> list[Floats]:
    """Return the references by step on which a PID is tuned [°C]. folder : of a scratch file"""
    return [_course(box_reference(facts, tuning, folder)) for tuning in TUNING]


def _course(path: Path) -> Floats:
    """Return the reference at each step [°C]."""
    times: Floats = STEP_S * np.arange(round(read_profile(path).end_s / STEP_S), dtype=np.float64)
    return reference_from_profile(path).at(times, times)


def install(found: Commissioned, settings: Settings, folder: Path) -> None:
    """Make a bundle of what was found the rig's active one, signed by a key of its own."""
    keys, models = Path(settings.bundle.trusted_keys), folder / "models"
    for made in (keys, models):
        made.mkdir(parents=True, exist_ok=True)
    write_twin_file(found.twin, models / "twin.yaml")
    if found.arx is not None:
        write_arx(found.arx.model, models / "arx.json", {"command": "bench.boxes"})
    private = folder / "signing.pem"
    public = generate_key(private)
    shutil.move(public, keys)
    archive = folder / "twin.zip"
    build_bundle(models, archive, ManifestFacts("1.0", "2026-01-01T00:00:00Z", "0" * 64, STEP_S), private)
    store = BundleStore(Path(settings.bundle.path), keys, loader(STEP_S))
    with open_archive(archive) as file:
        store.install(file)
    store.change(lambda roles: activate(roles, None))


@dataclass(frozen=True, slots=True)
class BoxResult:
    """A box's lines, and its cost by reference and row: empty where it was not commissioned."""

    lines: list[str]
    costs: dict[str, dict[str, float]]


def measure(box: int, minutes: float, references: Sequence[str], names: Sequence[str]) -> BoxResult:
    """Commission a box and hold it to each reference by each of the rows that are named."""
    facts = draw_box(box)
    try:
        found = commission(facts, box, minutes)
    except GreenhouseError as error:
        return BoxResult([f"{box:3d} {facts.kind}: not commissioned: {error}"], {})
    told, hours = found.expectation, found.expectation.hours
    lines = [
        f"{box:3d} {facts.kind}: {', '.join(found.names) or 'nothing'} added; free runs off by "
        f"{told.error_k:.2f} K",
        f"    full heat for {hours:g} h: {told.reach_c - told.room_c:.1f} K promised, "
        f"{rise_after_k(facts, hours):.1f} K true",
    ]
    lines += [f"    refused: {reason}" for reason in found.refusals]
    costs = {}
    for reference in references:
        costs[reference], rows = _rows(facts, box, found, reference, names)
        lines += [f"    {reference}", *rows] if len(references) > 1 else rows
    return BoxResult(lines, {} if found.refusals else costs)


def _rows(
    facts: BoxFacts, box: int, found: Commissioned, reference: str, names: Sequence[str]
) -> tuple[dict[str, float], list[str]]:
    """Return the cost by row, and the lines of them."""
    cost, lines = {}, []
    for name in names:
        if found.arx is None and name.removesuffix(EARLY) in OVER_ARX:
            lines.append(f"    {name:<17} no ARX model could be fitted")
            continue
        row = drive(facts, box, name, found, reference)
        cost[name] = row.cost
        lines.append(
            f"    {name:<17}{row.cost:9.1f}{row.mae_k:8.3f}{row.before_k:8.2f}{row.fan_starts:6d}"
            f"{row.cycles:4d}{row.heat_wh:8.0f}"
        )
    return cost, lines


def summary(costs: Sequence[dict[str, float]]) -> list[str]:
    """Return how the twin's rows compare, by rule: the limit is the cheapest row under the same one."""
    lines = []
    for end in ("", EARLY):
        own, past, ahead = f"{OF_TWIN}{end}", [], 0
        for cost in costs:
            same = {name: value for name, value in cost.items() if name.endswith(EARLY) == bool(end)}
            rivals = [value for name, value in same.items() if name not in (own, f"{CLAIRVOYANT}{end}")]
            if own in same and rivals:
                past.append(same[own] / min(same.values()))
                ahead += same[own] < min(rivals)
        if past:
            middle, worst = float(np.median(past)), max(past)
            lines.append(
                f"{own}: by the limit {middle:.2f} in the median, {worst:.2f} in the worst; ahead of every "
                f"rival in {ahead} of {len(past)}"
            )
    return lines


def main(words: Sequence[str] | None = None) -> int:
    """Print a table per box, and what they come to."""
    parser = argparse.ArgumentParser(prog="python -m bench.boxes", description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", default=LOTS[0], help="of bench.boxes.draw")
    parser.add_argument("--minutes", type=float, default=120.0, help="of commissioning; default: 120")
    parser.add_argument(
        "--reference", nargs="+", default=["reference_1"], help="one or more; default: reference_1"
    )
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS, help="default: all")
    parser.add_argument("--jobs", type=int, default=2, help="processes; default: 2")
    given = parser.parse_args(words)
    print("\n".join(header()))
    print(f"{', '.join(given.reference)}, {given.minutes:g} min of commissioning; cost, MAE [K],")
    print(
        "how far it left the reference towards a step before it [K], starts of the fan,",
        "cycles of fan and heat, heat [Wh]",
        sep="\n",
        flush=True,
    )
    costs: dict[str, list[dict[str, float]]] = {name: [] for name in given.reference}
    with ProcessPoolExecutor(given.jobs) as pool:
        jobs = [pool.submit(measure, box, given.minutes, given.reference, given.rows) for box in given.boxes]
        for job in jobs:
            result = job.result()
            print("\n".join(result.lines), flush=True)
            for name in result.costs:
                costs[name].append(result.costs[name])
    count = len(costs[given.reference[0]])
    print(f"commissioned: {count} of {len(given.boxes)} boxes")
    for name, boxes in costs.items():
        print("\n".join([f"{name}:", *summary(boxes)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
