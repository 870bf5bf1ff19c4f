"""python -m bench.drift_alarms: false alarms of the drift monitor, and how long it takes to see a change.

False alarms: the test alone, learning included, over many simulated rigs whose innovations have the twin's
stated size and a colour of their own. Delays: the whole monitor over a box that is a twin with noise.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median

import numpy as np

from bench.drift_box import UTC_0, Chances, DriftBox, heat_for, switching, ticks, with_fan
from edge.bundle.store import PACKAGED_FOLDER
from edge.core.predictor import Floats
from edge.drift import evidence, noise
from edge.drift.evidence import Evidence
from edge.drift.monitor import DriftMonitor, Promise
from edge.drift.regimes import CELLS, StepSituation, situation
from edge.models.pbm import read_twin
from edge.twin.model import BoxTwin

STEP_S = 60.0
TICKS_A_DAY = 1440
ROOM_C, LIFT_K, LIFT_TICKS = 21.0, 12.0, 30.0  # a temperature for the regime of a warm box
CHANGE_H = 24
BOX_LEARN_H = 4.0  # four cells in less than CHANGE_H


@dataclass(frozen=True, slots=True)
class Colour:
    """Innovations in units of the twin's stated noise: a slow part of first order, and white beside it."""

    name: str
    phi: float = 0.0
    white: float = 0.0  # sd of the white part over that of the slow one
    degrees: float = np.inf  # of freedom of Student's t, at variance 1


COLOURS = (
    Colour("white"),
    Colour("white, Student t with 4 degrees", degrees=4.0),
    Colour("memory 4.5 min", phi=0.8),
    Colour("memory 10 min, half of it white", phi=0.9, white=1.0),
    Colour("memory 33 min, half of it white", phi=0.97, white=1.0),
    Colour("memory 100 min", phi=0.99),
)


@dataclass(frozen=True, slots=True)
class Alarms:
    """Over all paths; times in ticks."""

    count: int
    first: Floats  # of each path that had one
    change: Floats  # what the first alarm said of the change's begin


@dataclass(frozen=True, slots=True)
class Alarm:
    """The first one of a box, in ticks from the change on."""

    delay: int
    begin: float  # as it was told
    where: str


def simulate(
    colour: Colour, paths: int, days: float, promise: Promise, shift: float = 0.0, at: int = 0, seed: int = 0
) -> Alarms:
    """Many rigs side by side, with the same inputs; after an alarm a path begins with no evidence.

    shift : added to the innovations from tick `at` on
    """
    random = np.random.default_rng(seed)
    threshold = evidence.log_threshold(promise.false_alarm_days, STEP_S)
    learn = round(promise.learn_h * 3600.0 / STEP_S)
    seen, sums = Evidence.none(0.0, (paths,)), noise.nothing_learnt((paths,))
    weights = [noise.cautious((paths,))] * CELLS
    past, slow = noise.InnovationPast(np.zeros(paths), np.zeros(paths)), np.zeros(paths)
    count, first, change = 0, np.full(paths, np.nan), np.full(paths, np.nan)
    for k, now in enumerate(_situations(round(days * TICKS_A_DAY), seed)):
        slow = colour.phi * slow + np.sqrt(1.0 - colour.phi**2) * _draw(random, colour.degrees, paths)
        z = (slow + colour.white * random.standard_normal(paths)) / np.hypot(1.0, colour.white)
        z += shift if k >= at else 0.0
        white = noise.whiten(weights[now.cell], z, past)
        if noise.count(sums, now.cell) < learn:
            sums = noise.learnt(sums, now.cell, z, past)
            if noise.count(sums, now.cell) >= learn:
                weights[now.cell] = noise.weights(sums, now.cell)
        past = noise.follow(past, z, STEP_S)
        seen = evidence.hear(seen, white, now.regimes, float(k), threshold)
        # As after a reset on the rig: evidence is gone, what was learnt of the noise stays.
        for path in np.flatnonzero(seen.total >= threshold):
            count += 1
            if np.isnan(first[path]):
                place = int(np.argmax(seen.cusum[path]))
                first[path], change[path] = k, seen.since_utc[path].flat[place]
            seen.log_sum[path], seen.cusum[path] = -np.inf, 0.0
    return Alarms(count, first[np.isfinite(first)], change[np.isfinite(first)])


def _situations(count: int, seed: int) -> Iterator[StepSituation]:
    inputs = switching(count + 1, seed)
    duty, fan = np.array([item.duty for item in inputs]), np.array([item.fan for item in inputs])
    temp = np.empty(count + 1)
    temp[0] = ROOM_C
    for k in range(count):
        rest = ROOM_C + LIFT_K * duty[k] * (1.0 - 0.5 * fan[k])
        temp[k + 1] = temp[k] + (rest - temp[k]) / LIFT_TICKS
    room = np.full(count + 1, ROOM_C)
    columns = {"heater_duty": duty, "fan_on": fan, "temp_air": temp, "temp_ambient": room}
    for k in range(1, count + 1):
        rows = slice(max(0, k - 10), k + 1)
        yield situation({name: column[rows] for name, column in columns.items()}, STEP_S)


def _draw(random: np.random.Generator, degrees: float, paths: int) -> Floats:
    if np.isinf(degrees):
        return random.standard_normal(paths)
    return np.asarray(random.standard_t(degrees, paths) * np.sqrt((degrees - 2.0) / degrees))


def false_alarms(paths: int, days: float, promise: Promise) -> None:
    """Print a row for each colour of noise."""
    print(f"| innovations | false alarms in {paths * days:g} days | per {promise.false_alarm_days:g} days |")
    print("|---|---|---|")
    for colour in COLOURS:
        count = simulate(colour, paths, days, promise).count
        print(
            f"| {colour.name} | {count} | {count * promise.false_alarm_days / (paths * days):.2f} |",
            flush=True,
        )


def first_alarm(
    change: DriftBox, believed: BoxTwin, promise: Promise, heat_w: float, seed: int
) -> Alarm | None:
    """Return the first alarm of a box that changes after CHANGE_H and is then watched for a day."""
    begin = round(CHANGE_H * 3600.0 / STEP_S)
    same = DriftBox(believed)
    told = ticks(
        DriftMonitor(promise),
        believed,
        lambda k: change if k > begin else same,
        switching(begin + TICKS_A_DAY, seed),
        seed,
        Chances(heat_w=heat_w),
    )
    for k, drift in enumerate(told):
        if drift.since_utc is not None:
            return Alarm(k - begin, (drift.since_utc - UTC_0) / STEP_S - begin, drift.where)
    return None


def delays(boxes: int, promise: Promise) -> None:
    """Print a row for each change, and for none."""
    twin = read_twin(PACKAGED_FOLDER / "twin.yaml").twin
    changes = {
        "none": DriftBox(twin),
        "heat that lifts the resting box by 0.5 K": DriftBox(twin, heat_w=heat_for(twin, 0.5)),
        "heat that lifts it by 1 K": DriftBox(twin, heat_w=heat_for(twin, 1.0)),
        "heat that lifts it by 2 K": DriftBox(twin, heat_w=heat_for(twin, 2.0)),
        "fan at half its effect": DriftBox(with_fan(twin, 0.5)),
    }
    print(
        "\n| change | heat noise | told in a day | after, median [min] | begin off by, median [min] | where |"
    )
    print("|---|---|---|---|---|---|")
    for heat_w in (1.5, 3.0):
        for name, box in changes.items():
            tried = [first_alarm(box, twin, promise, heat_w, seed) for seed in range(boxes)]
            found = [alarm for alarm in tried if alarm is not None]
            late = f"{median(alarm.delay for alarm in found):g}" if found else ""
            off = f"{median(abs(alarm.begin) for alarm in found):g}" if found else ""
            where = ", ".join(f"{place} {n}" for place, n in Counter(a.where for a in found).most_common(3))
            row = (name, f"{heat_w:g} W", f"{len(found)} of {boxes}", late, off, where)
            print(f"| {' | '.join(row)} |", flush=True)


def main() -> None:
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=100)
    parser.add_argument("--days", type=float, default=60.0)
    parser.add_argument("--boxes", type=int, default=20)
    arguments = parser.parse_args()
    false_alarms(arguments.paths, arguments.days, Promise(STEP_S))
    delays(arguments.boxes, Promise(STEP_S, learn_h=BOX_LEARN_H))


if __name__ == "__main__":
    main()
