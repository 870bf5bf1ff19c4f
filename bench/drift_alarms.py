"""python -m bench.drift_alarms: false alarms of the drift monitor, and how long it takes to see a change.

False alarms: the test alone, learning included, over many simulated rigs whose innovations have the twin's
stated size and a colour of their own. Delays: the whole monitor over `DriftBox`, a twin with noise that
changes. Its ticks are what the tests of the monitor see too.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from edge.bundle.store import PACKAGED_FOLDER
from edge.core.messages import Drift
from edge.core.predictor import Floats
from edge.drift import evidence, noise
from edge.drift.evidence import Evidence
from edge.drift.monitor import DriftMonitor, Promise
from edge.drift.regimes import CELLS, StepSituation, situation
from edge.models.pbm import read_twin
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

ROWS = 120  # of the history that a monitor sees, as the estimator's
ROOM_C = 21.0
UTC_0 = 1_767_225_600.0  # 2026-01-01T00:00Z
STEP_S = 60.0
TICKS_A_DAY = 1440
LIFT_K, LIFT_TICKS = 12.0, 30.0  # a temperature for the regime of a warm box
CHANGE_H = 24
BOX_LEARN_H = 4.0  # four cells in less than CHANGE_H


@dataclass(frozen=True, slots=True)
class Chances:
    """The box's own noise; the twin's stated one is another matter."""

    sensor_k: float = 0.05
    heat_w: float = 3.0
    heat_memory_s: float = 300.0  # of the heat


@dataclass(frozen=True, slots=True)
class TickInputs:
    """One tick's."""

    duty: float
    fan: float


def switching(ticks: int, seed: int) -> list[TickInputs]:
    """Heater and fan as a thermostat might drive them: each stays a while, then changes."""
    random = np.random.default_rng(seed)
    found, duty, fan = [], 0.3, 0.0
    for _ in range(ticks):
        if random.random() < 1.0 / 20.0:
            duty = float(random.choice([0.0, 0.0, 0.2, 0.4, 0.7]))
        if random.random() < 1.0 / 15.0:
            fan = 1.0 - fan
        found.append(TickInputs(duty, fan))
    return found


@dataclass(frozen=True, slots=True)
class DriftBox:
    """The truth at a tick: the physics, further heat [W], and the sensor's bias [K]."""

    twin: BoxTwin
    heat_w: float = 0.0
    bias_k: float = 0.0


def ticks(
    monitor: DriftMonitor,
    believed: BoxTwin,
    box: Callable[[int], DriftBox],
    inputs: list[TickInputs],
    seed: int = 0,
    chances: Chances = Chances(),
    columns: Callable[[dict[str, Floats], int], None] = lambda rows, k: None,
) -> Iterator[Drift]:
    """Yield the monitor's verdict at each tick.

    believed : the twin that is watched; box : what is there at tick k
    columns : may change the rows before tick k is shown: missing readings
    """
    random = np.random.default_rng(seed)
    rows = _rows(inputs, believed.step_s)
    physics = box(0).twin
    state = at_rest(physics, ROOM_C + 2.0, ROOM_C)
    left = np.exp(-believed.step_s / chances.heat_memory_s)
    heat_w = 0.0
    for k in range(len(inputs)):
        here = box(k)
        measured = state[0] + here.bias_k + chances.sensor_k * random.standard_normal()
        rows["temp_air"][k] = rows["temp_air_measured"][k] = measured
        columns(rows, k)
        shown = {name: column[max(0, k + 1 - ROWS) : k + 1] for name, column in rows.items()}
        yield monitor.tick(believed, shown, confirmed=True)
        # A heat that wanders, since white noise is what the filter expects anyway.
        heat_w = left * heat_w + np.sqrt(1.0 - left**2) * chances.heat_w * random.standard_normal()
        source = (heat_w + here.heat_w) / here.twin.system.air_capacity_j_k
        state = here.twin.advance(state, ROOM_C, inputs[k].duty, inputs[k].fan, source)


def with_fan(twin: BoxTwin, share: float) -> BoxTwin:
    """Return the same box with a fan that moves this share of the air."""
    effects = {name: dict(values) for name, values in twin.effects.items()}
    effects["fan_effectiveness"]["eps_f"] *= share
    return replace(twin, effects=effects)


def heat_for(twin: BoxTwin, lift_k: float) -> float:
    """Constant heat into the air that moves the resting box by `lift_k` while the fan is off [W]."""
    effects = twin.effects["wall_mass"]
    loss_w_k = 1.0 / (1.0 / effects["G_in"] + 1.0 / effects["G_out"])
    return loss_w_k * lift_k


def _rows(inputs: list[TickInputs], step_s: float) -> dict[str, Floats]:
    count = len(inputs)
    time_s = step_s * np.arange(count)
    return {
        "time_s": time_s,
        "utc": UTC_0 + time_s,
        "temp_air": np.full(count, np.nan),
        "temp_air_measured": np.full(count, np.nan),
        "temp_ambient": np.full(count, ROOM_C),
        "heater_duty": np.array([item.duty for item in inputs]),
        "fan_on": np.array([item.fan for item in inputs]),
        "light": np.full(count, np.nan),
    }


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
