"""python -m bench.boxes: boxes commissioned from nothing, then held to a reference by rules, PID, MPC, twin.

The cost is the paper's, 10 e² a step and the effort, but with the error at every 5 s, so that what happens
between two ticks counts. PID is tuned by SIMC (Skogestad, J. Process Control 13, 2003) on the same tests. The
paper's MPC has its bounds. Every row knows the same of the future: --present none, else the coming reference
where a controller has a use for it.
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
from bench.boxes.draw import draw_box
from bench.boxes.facts import BoxFacts
from bench.boxes.reach import scaled_reference
from bench.header import header
from edge.app.commission import Commissioned, learn, record, test_settings
from edge.board.virtual_rig import settings_in
from edge.bundle.archive import open_archive
from edge.bundle.predictors import loader
from edge.bundle.roles import activate
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key
from edge.bundle.store import BundleStore
from edge.config.settings import DriftSettings, ReferenceSettings, Settings
from edge.controllers.pid import Pid
from edge.core.controller import Controller
from edge.core.errors import GreenhouseError
from edge.formats.profile_file import read_profile
from edge.models.arx_file import write_arx
from edge.twin.new_file import BoxDescription, text
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.warm_start import at_rest
from firmware_protocol.virtual_board.plant import Plant
from training.control.draw_references import FOLDER
from training.lab import InProcessBoard, Lab

Floats = NDArray[np.float64]
ROLES = {"none": "none", "stir": "stirring", "exchange": "exhaust"}
EARLY = "MPC-Twin-P/early"  # the same, allowed to leave the reference before a step of it as the MPCs do
ROWS = ("rules", "PID", "MPC-P", "MPC-BFGS-P", "MPC-Twin-P", EARLY)
PREVIEWING = ("MPC-P", "MPC-BFGS-P", "MPC-Twin-P")
ANY_K = 20.0
SAMPLE_S, STEP_S = 5.0, 60.0
EXCURSION_MIN = 20  # before a step of the reference
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
    """A run. before_k : largest error in the minutes before a step of the reference"""

    controller: str
    cost: float
    mae_k: float
    before_k: float
    fan_starts: int
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
    return replace(
        rig, box=replace(rig.box, twin=str(path)), safety=safety, drift=DriftSettings(enabled=False)
    )


def commission(facts: BoxFacts, seed: int, minutes: float) -> Commissioned:
    """Commission a box from its description. Errors: GreenhouseError"""
    start = description(facts)
    with tempfile.TemporaryDirectory(prefix="boxes-") as temporary:
        box = Box(facts, seed)
        board = InProcessBoard(seed, plant=Plant(box, box.parts()))
        settings = test_settings(rig_settings(Path(temporary), start))
        run = record(settings, board, start.fan_role != "none", minutes, open_port=board.open)
    return learn(run, start, STEP_S, lambda text, share: None)


def simc(twin: TwinFile, room_c: float) -> tuple[float, float, float]:
    """Return a PI's gains [1/K, 1/(K s), 0] by SIMC from the twin's step response: delay, slope, gain."""
    model = twin.twin()
    steps = round(6 * 3600.0 / STEP_S)
    ones, zeros = np.ones((1, steps)), np.zeros((1, steps))
    rest = at_rest(model, room_c, room_c)
    given = {name: np.zeros(steps) for name in model.needs}
    heated = model.rollout(rest, ones, zeros, room_c, conditions=given, before=Commands(zeros, zeros))
    idle = model.rollout(rest, zeros, zeros, room_c, conditions=given, before=Commands(zeros, zeros))
    rise = (heated - idle)[0]
    gain_k = float(rise[-1])
    t1, t2 = (STEP_S * (1 + float(np.argmax(rise >= share * gain_k))) for share in (0.283, 0.632))
    tau_s = 1.5 * (t2 - t1)  # two-point fit of a first order with delay (Sundaresan, Krishnaswamy 1978)
    delay_s = max(t2 - tau_s, 0.0) + STEP_S  # and half a step of hold, half of the mean's
    kp = max(tau_s, STEP_S) / (gain_k * 2.0 * delay_s)
    return kp, kp / min(max(tau_s, STEP_S), 8.0 * delay_s), 0.0


def drive(
    facts: BoxFacts, seed: int, name: str, found: Commissioned, reference: str, present: bool
) -> BoxRow:
    """Hold a box to a scaled reference."""
    with tempfile.TemporaryDirectory(prefix="boxes-") as temporary:
        folder = Path(temporary)
        path = _reference(facts, reference, folder)
        settings = rig_settings(folder, found.twin)
        control = replace(
            settings.control,
            controller="MPC-Twin-P" if name == EARLY else name if name in PREVIEWING else "rules",
            twin_early_k=ANY_K if name == EARLY else settings.control.twin_early_k,
            preview=name in PREVIEWING and not present,
            twin_preview=not present,
            time_box_ms=60_000.0,
        )
        settings = replace(
            settings, control=control, reference=ReferenceSettings(kind="csv", csv=str(path), min_c=5.0)
        )
        _install(found, settings, folder)
        more: dict[str, Any] = {}
        if name == "PID":
            instead: Controller = Pid(*simc(found.twin, found.expectation.room_c))
            more = {"more_controllers": (instead,), "experiment": "PID"}
        box = WatchedBox(facts, seed + 1000)
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
    before = [
        float(np.abs(error[(place[known] >= k - EXCURSION_MIN // 2) & (place[known] < k)]).max(initial=0.0))
        for k in steps
        if ticks[k] > ticks[0] + WARM_UP_S + 60.0 * EXCURSION_MIN
    ]
    per_step = 10.0 * error**2 * SAMPLE_S / STEP_S
    ended = np.append(0.0, fan[:-1]) >= 1.0
    return BoxRow(
        name,
        float(per_step.sum() + (duty**2).sum() + fan.sum()),
        float(np.abs(error).mean()),
        max(before, default=0.0),
        int(((fan > 0.0) & ~ended).sum()),
        float(duty.sum()) * heater_w * STEP_S / 3600.0,
    )


def _reference(facts: BoxFacts, name: str, folder: Path) -> Path:
    profile = read_profile(FOLDER / f"{name}.csv")
    course = profile.columns["reference_c"]
    scaled = scaled_reference((course - course.min()) / (course.max() - course.min()), facts)
    path = folder / "reference.csv"
    rows = zip(profile.columns["time_s"], scaled, strict=True)
    path.write_text(
        "\n".join(["time_s,reference_c", *(f"{time:g},{value:.3f}" for time, value in rows)]) + "\n"
    )
    return path


def _install(found: Commissioned, settings: Settings, folder: Path) -> None:
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


def table_of(box: int, minutes: float, reference: str, present: bool) -> list[str]:
    """Return the lines of one box."""
    facts = draw_box(box)
    try:
        found = commission(facts, box, minutes)
    except GreenhouseError as error:
        return [f"{box:3d} not commissioned: {error}"]
    said = f"{box:3d} {facts.kind}: {', '.join(found.names) or 'nothing'} added"
    lines = [f"{said}; free runs off by {found.expectation.error_k:.2f} K"]
    lines += [f"    refused: {reason}" for reason in found.refusals]
    for name in ROWS:
        if found.arx is None and name in ("MPC-P", "MPC-BFGS-P"):
            lines.append(f"    {name:<12} no ARX model could be fitted")
            continue
        row = drive(facts, box, name, found, reference, present)
        figures = f"{row.cost:9.1f}{row.mae_k:8.3f}{row.before_k:8.2f}{row.fan_starts:6d}{row.heat_wh:8.0f}"
        lines.append(f"    {name:<17}{figures}")
    return lines


def main(words: Sequence[str] | None = None) -> int:
    """Print a table per box."""
    parser = argparse.ArgumentParser(prog="python -m bench.boxes", description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", required=True, help="numbers of bench.boxes.draw")
    parser.add_argument("--minutes", type=float, default=120.0, help="of commissioning; default: 120")
    parser.add_argument("--reference", default="reference_1", help="default: reference_1")
    parser.add_argument("--present", action="store_true", help="no controller knows the coming reference")
    parser.add_argument("--jobs", type=int, default=2, help="processes; default: 2")
    given = parser.parse_args(words)
    print("\n".join(header()))
    print(f"{given.reference}, {given.minutes:g} min of commissioning; cost, MAE [K],")
    print("largest error before a step [K], starts of the fan, heat [Wh]", flush=True)
    with ProcessPoolExecutor(given.jobs) as pool:
        jobs = [
            pool.submit(table_of, box, given.minutes, given.reference, given.present) for box in given.boxes
        ]
        for job in jobs:
            print("\n".join(job.result()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
