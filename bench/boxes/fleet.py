"""python -m bench.boxes.fleet: a new box learnt from an hour with the prior of its fleet, from six without.

Each design is built several times, with the tolerances of its parts and in rooms of their own (siblings.py).
Every box was commissioned for six hours, has run for a day since, and tells the fleet the twin of both. The
fleet fits each structure that one has told, and some that join two, to the data of all, and rehearses: each
of its boxes is learnt from an hour and what the others tell.
Leave one out: to each in turn, as if it were new, the others of its design give a prior. Its twin is learnt
from the first hour of its step tests with the prior, from that hour without, and from six hours without. One
more of each design is odd: a lid stands open, a heater is weaker; its fleet does not know.
Judged by the error of a free run over another day, and by the cost of MPC-Twin-P on reference_1 and
reference_2 together: the first has one large step up, whose first minute would decide alone. Runs are kept in
--out, so that a command that was ended goes on.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import time as clock_time
from functools import partial
from pathlib import Path

import numpy as np

from bench.boxes.__main__ import OF_TWIN, description, drive, rig_settings
from bench.boxes.box import Box
from bench.boxes.draw import DEVELOPMENT, SCORED, draw_box
from bench.boxes.facts import BoxFacts
from bench.boxes.own_data import free_run_errors, quiet
from bench.boxes.reach import scaled_reference
from bench.boxes.siblings import ODD, sibling
from bench.header import header
from edge.app.commission import Commissioned, chosen_twin, learn
from edge.app.step_test_record import STEP_S, record, test_settings
from edge.config.settings import ControlSettings, DailyReference, ReferenceSettings
from edge.core.errors import GreenhouseError
from edge.core.sweep import add_arguments, sweep
from edge.diagnosis.diagnose import diagnose
from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import DiagnosisRuns
from edge.formats.reader import read_json
from edge.formats.run_file import RecordedRun, absence_facts, cut, read_run, resample, write_run
from edge.storage.runs import export_stretches
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from firmware_protocol.virtual_board.plant import Plant
from fleet.priors.fleet_prior import BoxSheet, fit_prior
from fleet.priors.kind_structure import (
    Fits,
    Rehearsals,
    Structure,
    choose,
    fit_structure,
    in_kind_structure,
    loss_shares,
    structures,
)
from fleet.priors.rehearsal import Rehearsal, rehearse
from training.lab import InProcessBoard, Lab

LITTLE_H, MUCH_H = 1.0, 6.0
MINUTE_S = 60.0
DAY_MIN = 1500.0  # after the first hour of it, a day judges
WARM, COOL = 0.7, 0.25  # references by day and by night, shares as of scaled_reference
REFERENCES = ("reference_1", "reference_2")
NEAR = 0.05
KEYS = ("error_k", "cost")
ODDITIES = tuple(ODD)
KNOWN = (*DEVELOPMENT, *SCORED)


@dataclass(frozen=True, slots=True)
class FleetBox:
    """A box that was built to a design. odd : of ODD, "" for one as designed"""

    design: int
    number: int
    odd: str = ""

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"{self.design}-{self.number}" + self.odd.replace(" ", "-")

    @property
    def facts(self) -> BoxFacts:
        """The box."""
        return sibling(draw_box(self.design), self.number, self.odd)

    @property
    def start(self) -> TwinFile:
        """The design as a person describes it: the same for everybody who built it."""
        return description(draw_box(self.design))


def record_tests(out: Path, box: FleetBox) -> None:
    """Keep the step tests of a box."""
    path = out / f"{box.name}.tests.csv"
    if path.exists():
        return
    facts, start = box.facts, box.start
    with tempfile.TemporaryDirectory(prefix="fleet-") as temporary:
        body = Box(facts, facts.seed)
        board = InProcessBoard(facts.seed, plant=Plant(body, body.parts()))
        settings = test_settings(rig_settings(Path(temporary), start))
        run = record(settings, board, start.fan_role != "none", 60.0 * MUCH_H, open_port=board.open)
    if len(run) < 3600.0 * MUCH_H / STEP_S:
        raise GreenhouseError(f"{box.name}: the tests were ended after {len(run)} rows")
    write_run(absence_facts(run), path)


def record_day(out: Path, box: FleetBox) -> None:
    """Keep another day of the box, held to a daily reference by rules."""
    path = out / f"{box.name}.day.csv"
    if path.exists():
        return
    facts = box.facts
    with tempfile.TemporaryDirectory(prefix="fleet-") as temporary:
        body = Box(facts, facts.seed + 500)
        cool, warm = scaled_reference(np.array([COOL, WARM]), facts).tolist()
        steps = (DailyReference(clock_time(6), warm), DailyReference(clock_time(22), cool))
        settings = rig_settings(Path(temporary), box.start)
        settings = replace(
            settings,
            control=replace(settings.control, controller="rules"),
            reference=ReferenceSettings(kind="daily", daily=steps, min_c=5.0),
        )
        plant = Plant(body, body.parts())
        lab = Lab(settings, board="here", plant=plant, seed=facts.seed, folder=Path(temporary))
        with lab:
            lab.run(minutes=DAY_MIN)
        *_, day = export_stretches(settings.history.path)
    write_run(absence_facts(day), path)


def first_hours(run: RecordedRun, hours: float) -> RecordedRun:
    """Return the begin of step tests."""
    return cut(run, 0, min(len(run), round(3600.0 * hours / STEP_S)))


def tell_fleet(out: Path, box: FleetBox) -> None:
    """Keep the twin that a box of the fleet tells: of its tests and of the day after."""
    path = out / f"{box.name}.told.yaml"
    if path.exists():
        return
    file, runs = _own_data(out, box)
    write_twin_file(chosen_twin(diagnose(file, runs, quiet, "python -m bench.boxes.fleet"))[0], path)


def _own_data(out: Path, box: FleetBox) -> tuple[TwinFile, DiagnosisRuns]:
    file = replace(box.start, sample_s=MINUTE_S)
    tests, day = (read_run(out / f"{box.name}.{name}.csv") for name in ("tests", "day"))
    return file, history_runs([first_hours(tests, MUCH_H), day], file)


def fit_box(out: Path, wanted: tuple[FleetBox, Structure]) -> None:
    """Keep the twin of a box in a structure that one of its fleet has told."""
    path = _fit_path(out, *wanted)
    if not path.exists():
        box, structure = wanted
        file, runs = _own_data(out, box)
        write_twin_file(fit_structure(file, runs, structure), path)


def _fit_path(out: Path, box: FleetBox, structure: Structure) -> Path:
    return out / f"{'+'.join((box.name, *structure))}.fit.yaml"


def rehearse_box(out: Path, wanted: tuple[FleetBox, Structure, tuple[FleetBox, ...]]) -> None:
    """Keep what a box would be missed by if it were new, by others in a structure."""
    box, structure, others = wanted
    path = _rehearsal_path(out, *wanted)
    if path.exists():
        return
    tests, day = (read_run(out / f"{box.name}.{name}.csv") for name in ("tests", "day"))
    told = read_twin_file(out / f"{box.name}.told.yaml")
    twins = [read_twin_file(_fit_path(out, other, structure)) for other in others]
    path.write_text(json.dumps(asdict(rehearse(told, [first_hours(tests, MUCH_H), day], twins))))


def _rehearsal_path(out: Path, box: FleetBox, structure: Structure, others: tuple[FleetBox, ...]) -> Path:
    by = "".join(str(other.number) for other in others)
    return out / f"{'+'.join((box.name, *structure))}.by-{by}.json"


def rehearsals_wanted(
    out: Path, fleet: Sequence[FleetBox]
) -> list[tuple[FleetBox, Structure, tuple[FleetBox, ...]]]:
    """Return each box with each structure, and the others of all and of each fleet that lacks one more."""
    return [
        (box, name, _others(fleet, box, left_out))
        for box, name in fits_wanted(out, fleet)
        for left_out in fleet
    ]


def _others(fleet: Sequence[FleetBox], *without: FleetBox) -> tuple[FleetBox, ...]:
    return tuple(box for box in fleet if box not in without)


def fits_wanted(out: Path, fleet: Sequence[FleetBox]) -> list[tuple[FleetBox, Structure]]:
    """Return each box with each structure of its fleet, and of each fleet that lacks one more."""
    sheets = sheets_of(out, fleet)
    parts = [[*sheets.values()], *([sheets[box] for box in _others(fleet, new)] for new in fleet)]
    kind = str(fleet[0].design)
    names = {name for part in parts if part for name in structures(part)[kind]}
    return [(box, name) for box in fleet for name in sorted(names)]


@dataclass(frozen=True, slots=True)
class NewBoxRow:
    """A new box, by a way to learn; None where nothing was learnt.

    error_k : of a free run over another day, mean; cost : on all references together
    added : effects beside those that it began with
    """

    box: str
    odd: str
    way: str
    error_k: float | None = None
    cost: float | None = None
    refused: str = ""
    added: str = ""


def sheets_of(out: Path, boxes: Sequence[FleetBox]) -> dict[FleetBox, BoxSheet]:
    """Return what the boxes tell."""
    return {
        box: BoxSheet(box.name, str(box.design), read_twin_file(out / f"{box.name}.told.yaml"))
        for box in boxes
    }


def place_of(out: Path, fleet: Sequence[FleetBox]) -> Path:
    """Return the folder of all that is learnt with the prior of this fleet."""
    return out / f"prior_of_{fleet[0].design}_built_{len(fleet)}"


def give_starts(out: Path, fleet: Sequence[FleetBox], new: Sequence[FleetBox]) -> None:
    """Keep the twin from which each box starts, by the prior of all others."""
    fits = known_fits(out, fleet)
    for box in new:
        path = place_of(out, fleet) / f"{box.name}.start.yaml"
        if not path.exists():
            rehearsed = known_rehearsals(out, fleet, box)
            others, chosen = choice_of_others(out, fleet, fits, rehearsed, box)
            shares = loss_shares(others, chosen, rehearsed)
            prior = fit_prior(in_kind_structure(others, fits, chosen), shares)
            write_twin_file(prior.start(box.start, str(box.design)), path)


def known_fits(out: Path, fleet: Sequence[FleetBox]) -> Fits:
    """Return what is kept of the fleet."""
    wanted = fits_wanted(out, fleet)
    return {(box.name, name): read_twin_file(_fit_path(out, box, name)) for box, name in wanted}


def choice_of_others(
    out: Path, fleet: Sequence[FleetBox], fits: Fits, rehearsed: Rehearsals, new: FleetBox
) -> tuple[list[BoxSheet], dict[str, Structure]]:
    """Return what the fleet without a box tells, and what serves a new box of it best."""
    others = [sheet for other, sheet in sheets_of(out, fleet).items() if other != new]
    return others, choose(others, fits, rehearsed)


def chosen_fit(out: Path, fleet: Sequence[FleetBox], box: FleetBox) -> TwinFile:
    """Return a box's twin of all that it recorded, in the structure that the others have."""
    fits = known_fits(out, fleet)
    _, chosen = choice_of_others(out, fleet, fits, known_rehearsals(out, fleet, box), box)
    return fits[box.name, chosen[str(box.design)]]


def known_rehearsals(out: Path, fleet: Sequence[FleetBox], new: FleetBox) -> Rehearsals:
    """Return what is kept of the fleet without a box."""
    return {
        (box.name, name): read_json(Rehearsal, _rehearsal_path(out, box, name, _others(fleet, box, new)))
        for box, name in fits_wanted(out, fleet)
        if box != new
    }


WAYS = {"1 h": LITTLE_H, "6 h": MUCH_H, "1 h and prior": LITTLE_H}
ALONE = ("6 h", "1 h")


def judge_alone(out: Path, box: FleetBox) -> list[NewBoxRow]:
    """Return a row for each way to learn a box without a fleet, from files where they are kept."""
    record_tests(out, box)
    record_day(out, box)
    return [_row(out, out, box, box.start, way) for way in ALONE]


def judge_in_fleet(out: Path, fleet: Sequence[FleetBox], box: FleetBox) -> NewBoxRow:
    """Return the row of a box that starts with the prior of all others."""
    place = place_of(out, fleet)
    (way,) = WAYS.keys() - {*ALONE}
    return _row(out, place, box, read_twin_file(place / f"{box.name}.start.yaml"), way)


def _row(out: Path, place: Path, box: FleetBox, start: TwinFile, way: str) -> NewBoxRow:
    path = place / f"{box.name}.{way.replace(' ', '-')}.json"
    if path.exists():
        return read_json(NewBoxRow, path)
    run = read_run(out / f"{box.name}.tests.csv")
    try:
        found = learn(first_hours(run, WAYS[way]), start, ControlSettings(), quiet)
    except GreenhouseError as error:
        row = NewBoxRow(box.name, box.odd, way, refused=str(error))
    else:
        write_twin_file(found.twin, path.with_suffix(".yaml"))
        row = NewBoxRow(
            box.name, box.odd, way, day_error_k(out, box, found.twin), cost_of(box, OF_TWIN, found),
            "; ".join(found.refusals), ", ".join(found.names),
        )  # fmt: skip
    path.write_text(json.dumps(asdict(row)))
    return row


def day_error_k(out: Path, box: FleetBox, twin: TwinFile) -> float:
    """Return the mean error of a free run over a box's day [K]."""
    day = resample(read_run(out / f"{box.name}.day.csv"), MINUTE_S)
    return float(np.nanmean(np.abs(free_run_errors(twin, day))))


def cost_of(box: FleetBox, controller: str, found: Commissioned) -> float:
    """Return the cost of control on all references."""
    return sum(drive(box.facts, box.facts.seed, controller, found, name).cost for name in REFERENCES)


def table(rows: Sequence[NewBoxRow]) -> Iterator[str]:
    """Yield a line for each box, then how often the prior is worth five hours."""
    found = {(row.box, row.way): row for row in rows}
    odd = {row.box: bool(row.odd) for row in rows}
    yield f"{'box':<22}" + "".join(f"{way:>24}" for way in WAYS)
    for name in odd:
        yield f"{name:<22}" + "".join(_figures(found[name, way]) for way in WAYS)
    yield "mean error of a free run over another day [K], cost on both references; *: refused"
    usual = [name for name in odd if not odd[name]]
    for key in KEYS:
        yield _counts(found, usual, (key,))
        ways = [{way: _number(found[name, way], key) for way in WAYS} for name in odd if odd[name]]
        worse = [one["1 h and prior"] / one["1 h"] - 1.0 for one in ways if np.isfinite(one["1 h"])]
        if worse:
            yield f"{key}: of {len(ways)} odd boxes none is worse by the prior by more than {max(worse):.0%}"
    yield _counts(found, usual, KEYS)


def _counts(found: Mapping[tuple[str, str], NewBoxRow], boxes: Sequence[str], keys: Sequence[str]) -> str:
    """Say in how many boxes the prior is worth six hours by each of the keys."""

    def is_worth(box: str, key: str, share: float) -> bool:
        own = _number(found[box, "1 h and prior"], key)
        return bool(np.isfinite(own)) and own <= share * _number(found[box, "6 h"], key)

    worth, near = (
        sum(all(is_worth(box, key, share) for key in keys) for box in boxes) for share in (1.0, 1.0 + NEAR)
    )
    return (
        f"{' and '.join(keys)}: 1 h with the prior is as good as 6 h without "
        f"in {worth} of {len(boxes)} boxes, and no more than {NEAR:.0%} worse in {near}"
    )


def _figures(row: NewBoxRow) -> str:
    if row.error_k is None:
        return f"{'nothing learnt':>24}"
    return f"{row.error_k:11.2f} {row.cost:10.1f}{'*' if row.refused else ' '} "


def _number(row: NewBoxRow, key: str) -> float:
    value: float | None = getattr(row, key)
    return np.inf if value is None else value


def measure(design: int, given: argparse.Namespace) -> list[NewBoxRow]:
    """Return the rows of a design's boxes, from files where they are kept."""
    fleet = [FleetBox(design, number) for number in range(1, given.built + 1)]
    new = [*fleet, FleetBox(design, given.built + 1, ODDITIES[KNOWN.index(design) % len(ODDITIES)])]
    place_of(given.out, fleet).mkdir(parents=True, exist_ok=True)
    alone = sweep(partial(judge_alone, given.out), new, given.workers, given.dask)
    sweep(partial(tell_fleet, given.out), fleet, given.workers, given.dask)
    sweep(partial(fit_box, given.out), fits_wanted(given.out, fleet), given.workers, given.dask)
    sweep(partial(rehearse_box, given.out), rehearsals_wanted(given.out, fleet), given.workers, given.dask)
    give_starts(given.out, fleet, new)
    in_fleet = sweep(partial(judge_in_fleet, given.out, fleet), new, given.workers, given.dask)
    return [*in_fleet, *(row for lot in alone for row in lot)]


def parser_of(module: str, text: str | None) -> argparse.ArgumentParser:
    """Return the arguments of this module, and of those that stand beside what it has kept."""
    parser = argparse.ArgumentParser(prog=f"python -m bench.boxes.{module}", description=text)
    parser.add_argument("--designs", type=int, nargs="+", choices=KNOWN, required=True, metavar="DESIGN")
    parser.add_argument("--built", type=int, default=4, help="boxes of each design in the fleet (usual: 4)")
    parser.add_argument(
        "--out", type=Path, default=Path("out") / "boxes_fleet", help="of files that are kept"
    )
    add_arguments(parser)
    return parser


def boxes_of(given: argparse.Namespace) -> list[FleetBox]:
    """Return the boxes of the designs that are asked for."""
    return [FleetBox(design, k) for design in given.designs for k in range(1, given.built + 1)]


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing and print the table."""
    given = parser_of("fleet", __doc__).parse_args(words)
    print("\n".join(header()), flush=True)
    print("\n".join(table([row for design in given.designs for row in measure(design, given)])))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
