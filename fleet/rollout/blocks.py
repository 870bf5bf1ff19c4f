"""Blocks of a wave: taken once from hourly costs when their hours are over, and kept before the judgement."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean

from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.lab.cost import step_cost
from fleet.database.tables import FleetRig, RolloutBlock, RolloutRig, RolloutWave, are_there
from fleet.numbers.series import PREFIX, any_of
from fleet.numbers.victoria import Numbers
from fleet.rollout.judge import BLOCK_H, DAY_H, HOUR_S, HourCost, difference, relative_change
from fleet.rollout.states import RigState
from fleet.settings import NumbersSettings

BLOCK_S = BLOCK_H * HOUR_S
BEFORE_S = 3 * DAY_H * HOUR_S  # a box is compared with itself over so long before a wave
LATE_S = 1800.0  # ticks that are on their way when a block ends
COMPARED_MAX = 60  # waiting boxes of a kind: more of them tell little more and take their time to read
Costs = Callable[[str, float, float], list[HourCost]]  # of a rig, from and until a time [s since 1970]
QUANTITIES = ("temp_air_c", "reference_c", "sent_heater_duty", "sent_fan_share")
AIR, REFERENCE, DUTY, FAN = (PREFIX + quantity for quantity in QUANTITIES)
STEP_MAX_S = 600.0  # between two ticks that are neighbours
COVERED_LEAST = 0.75  # of an hour
MS = 1000

Samples = Mapping[str, Mapping[int, float]]  # name of a series -> time [ms] -> value


@dataclass(frozen=True, slots=True)
class ComparedRig:
    """A rig, and from when on until the wave it ran what it ran last."""

    name: str
    before_from: float


@dataclass(frozen=True, slots=True)
class ComparedRigs:
    """Rigs of a kind: changed by the wave, and those whose bundle stays as it is."""

    changed: Sequence[ComparedRig]
    waiting: Sequence[ComparedRig]


def who_compares(session: Session, wave: RolloutWave, utc: float) -> dict[str, ComparedRigs]:
    """Return who is compared with whom, by kind.

    Boxes of earlier waves keep their bundle while a later wave is judged, so they are compared with too; in
    the last wave there may be no others.
    """
    began = wave.began_utc
    before_from: dict[str, float] = {}
    changed: list[RolloutRig] = []
    moved: set[str] = set()
    for row in session.scalars(select(RolloutRig).order_by(RolloutRig.rig)):
        if (row.rollout, row.wave) == (wave.rollout, wave.wave):
            moved.add(row.rig)
            changed += [row] if row.state == RigState.ACTIVE else []
        elif row.since_utc >= began:
            moved.add(row.rig)
        else:
            before_from[row.rig] = max(before_from.get(row.rig, 0.0), row.since_utc)

    def rig(name: str) -> ComparedRig:
        return ComparedRig(name, max(before_from.get(name, 0.0) + HOUR_S, began - BEFORE_S))

    found = {row.kind: ComparedRigs([], []) for row in changed}
    for kind in found:
        stays = select(FleetRig.name).where(FleetRig.kind == kind, are_there(utc)).order_by(FleetRig.name)
        waiting = [rig(name) for name in session.scalars(stays) if name not in moved]
        own = [rig(row.rig) for row in changed if row.kind == kind]
        found[kind] = ComparedRigs(own, waiting[:COMPARED_MAX])
    return found


def due(wave: RolloutWave, known: Sequence[float], utc: float) -> Iterator[float]:
    """Yield the begin of each block that is over and is not among those that are known."""
    assert wave.judged_from_utc is not None
    begin = wave.judged_from_utc
    while begin + BLOCK_S + LATE_S <= utc:
        if begin not in known:
            yield begin
        begin += BLOCK_S


def take_block(
    wave: RolloutWave, kind: str, rigs: ComparedRigs, begin_utc: float, costs: Costs
) -> RolloutBlock:
    """Return the block of a kind that begins at a time. Errors: DataError where no numbers can be read"""

    def changes(own: Sequence[ComparedRig]) -> list[float]:
        found = (
            relative_change(
                costs(rig.name, begin_utc, begin_utc + BLOCK_S),
                costs(rig.name, rig.before_from, wave.began_utc),
                begin_utc,
            )
            for rig in own
        )
        return [change for change in found if change is not None]

    changed, waiting = changes(rigs.changed), changes(rigs.waiting)
    return RolloutBlock(
        rollout=wave.rollout,
        wave=wave.wave,
        kind=kind,
        begin_utc=begin_utc,
        difference=difference(changed, waiting),
        changed=len(changed),
        waiting=len(waiting),
    )


def costs_from(settings: NumbersSettings) -> Costs:
    """Return the reader of a fleet's numbers. The reader raises NumbersError where they cannot be read."""
    numbers = Numbers(settings)

    def costs(rig: str, since_utc: float, until_utc: float) -> list[HourCost]:
        # The step that begins before `until_utc` ends at the tick after it.
        samples = {
            series.labels["__name__"]: {
                round(MS * utc): value for utc, value in zip(series.utc, series.values, strict=True)
            }
            for series in numbers.series(any_of(QUANTITIES, rig), since_utc, until_utc + STEP_MAX_S)
        }
        return [hour for hour in hourly(samples) if since_utc <= hour.begin_utc < until_utc]

    return costs


def hourly(samples: Samples) -> list[HourCost]:
    """Return the mean cost of a step in each hour that is covered by steps, the oldest first."""
    found: dict[float, list[tuple[float, float]]] = defaultdict(list)
    for begin_s, length_s, cost in _steps(samples):
        found[begin_s // HOUR_S * HOUR_S].append((length_s, cost))
    return [
        HourCost(begin, fmean(cost for _, cost in steps))
        for begin, steps in sorted(found.items())
        if sum(length_s for length_s, _ in steps) >= COVERED_LEAST * HOUR_S
    ]


def _steps(samples: Samples) -> Iterator[tuple[float, float, float]]:
    """Yield begin [s], length [s] and cost of each step: its error is that of the air at the next tick."""
    air, reference, duty, fan = (samples.get(name, {}) for name in (AIR, REFERENCE, DUTY, FAN))
    times = sorted(reference.keys() & duty.keys() & fan.keys())
    for at, after in pairwise(times):
        if after in air and after - at <= MS * STEP_MAX_S:
            yield at / MS, (after - at) / MS, step_cost(air[after] - reference[at], duty[at], fan[at])
