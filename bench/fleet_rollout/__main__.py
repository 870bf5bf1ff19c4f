"""python -m bench.fleet_rollout: is a bad bundle stopped in its first wave, and how far gets a good one?

A fleet of 60 boxes of three kinds for each seed. The bundle "good" is learnt from more boxes than the one
that runs, and keeps its models for the kinds in which they are cheaper; in "bad" the model of one kind lacks
a quarter of the loss, or as much more as makes the kind's median box dearer by a quarter; "same" is what
runs, once more.
The runner of `fleet.rollout` spreads them, on a database, over boxes whose costs were simulated before: those
of the generator, linearised, driven by the bundle's model and a proportional correction, not by the daemon.
"""

import argparse
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from sqlalchemy.orm import Session

from bench.fleet_rollout.fleet_costs import HOURS, LEARNING, SimulatedCosts, fleet_costs, simulate
from bench.header import header
from edge.bundle import remote
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.database.tables import BundleRollout, FleetBundle, FleetRig, RolloutWave
from fleet.rollout.begin import begin
from fleet.rollout.blocks import BEFORE_S
from fleet.rollout.judge import HOUR_S, HourCost
from fleet.rollout.runner import RolloutRunner
from fleet.rollout.states import News, WaveState
from fleet.settings import DatabaseSettings, RolloutSettings

BEGIN_UTC = 480_000 * HOUR_S  # a day begins
BEGIN_H = round(BEFORE_S / HOUR_S) + 1
SETTINGS = RolloutSettings(address="http://fleet.example/bundles")
SCENARIOS = {"good": "good", "bad": "bad", "same": "old"}  # -> bundle that is spread
VERSION = "2.0"


@dataclass(slots=True)
class SimulatedFleet:
    """Rigs that obey at once, with simulated costs. active : since when each runs the new bundle"""

    costs: SimulatedCosts
    bundle: str
    utc: float
    active: dict[str, float] = field(default_factory=dict)
    told: list[News] = field(default_factory=list)

    def install(self, rig: str, url: str, sha256: str) -> bool:
        """Obey."""
        self.active[rig] = self.utc
        self.told.append(News(rig, f"bundle.{remote.INSTALL}", f"sha256 {sha256}, asked for"))
        return True

    def roll_back(self, rig: str, version: str) -> bool:
        """Obey."""
        self.active.pop(rig, None)
        self.told.append(News(rig, f"bundle.{remote.ROLL_BACK}", f"bundle {version}, asked for"))
        return True

    def hears(self) -> bool:
        """Return True."""
        return True

    def news(self) -> list[News]:
        """Return what the rigs told."""
        return self.told

    def confirm(self) -> None:
        """Forget it."""
        self.told = []

    def read(self, rig: str, since_utc: float, until_utc: float) -> list[HourCost]:
        """Return costs as the numbers of a fleet have them."""
        box = int(rig.rpartition("-")[2])
        found = []
        for hour in range(math.ceil((since_utc - BEGIN_UTC) / HOUR_S), HOURS):
            utc = BEGIN_UTC + hour * HOUR_S
            if utc >= until_utc:
                break
            bundle = self.bundle if utc >= self.active.get(rig, math.inf) else "old"
            found.append(HourCost(utc, float(self.costs.costs[bundle][box, hour])))
        return found


@dataclass(frozen=True, slots=True)
class RolloutRow:
    """A rollout. wave : in which it ended; hours : until then; first_h : of the first wave's judgement

    dearer : true cost of all boxes of each kind over the old bundle's, share, each box within the bound
    """

    seed: int
    scenario: str
    state: str
    wave: int
    hours: float
    first_h: float
    why: str
    dearer: dict[str, float]


def roll_out(seed: int, scenario: str, costs: SimulatedCosts) -> RolloutRow:
    """Spread a bundle through a simulated fleet to its end, or until the simulated time is over."""
    start = BEGIN_UTC + BEGIN_H * HOUR_S
    fleet = SimulatedFleet(costs, SCENARIOS[scenario], start)
    with tempfile.TemporaryDirectory(prefix="rollout-") as folder:
        engine = open_database(DatabaseSettings(url=f"sqlite:///{folder}/fleet.db"))
        with Session(engine) as session, session.begin():
            session.add_all(
                FleetRig(name=f"rig-{box}", kind=kind, first_utc=1.0, last_utc=math.inf, is_online=True)
                for box, kind in enumerate(costs.kinds)
            )
            session.add(
                FleetBundle(
                    sha256=f"{seed:064x}",
                    version=VERSION,
                    name="b",
                    created_utc="",
                    added_utc=1.0,
                    archive=b"",
                )
            )
        number = begin(engine, SETTINGS, f"{seed:064x}", "", start)
        lease = FleetLease(engine, "rollouts")
        lease.take()
        runner = RolloutRunner(engine, SETTINGS.address, fleet, fleet.read, lease.check)
        while fleet.utc < BEGIN_UTC + HOURS * HOUR_S:
            runner.look(fleet.utc)
            with Session(engine) as session:
                if session.get_one(BundleRollout, number).state != "running":
                    break
            fleet.utc += HOUR_S
        with Session(engine) as session:
            rollout = session.get_one(BundleRollout, number)
            first, last = (session.get_one(RolloutWave, (number, wave)) for wave in (1, rollout.wave))
            ended = fleet.utc if rollout.ended_utc is None else rollout.ended_utc
            row = RolloutRow(
                seed,
                scenario,
                last.state if last.state == WaveState.HELD else rollout.state,
                rollout.wave,
                (ended - start) / HOUR_S,
                ((first.ended_utc or ended) - start) / HOUR_S,
                rollout.why or last.why if rollout.state != "done" else first.why,
                true_dearer(costs, SCENARIOS[scenario]),
            )
        engine.dispose()
    return row


def true_dearer(costs: SimulatedCosts, bundle: str) -> dict[str, float]:
    """Return by which share a bundle is dearer for the boxes of each kind, over all time and boxes."""
    new, old = (costs.costs[name][:, BEGIN_H:].mean(axis=1) for name in (bundle, "old"))
    kinds = np.array(costs.kinds)
    return {kind: float(np.mean((new / old - 1.0)[kinds == kind])) for kind in dict.fromkeys(costs.kinds)}


def line(row: RolloutRow) -> str:
    """Return a line of the table."""
    truth = ", ".join(f"{kind} {share:+.0%}" for kind, share in row.dearer.items())
    return (
        f"{row.seed:4} {row.scenario:<6} {f'{row.state}, wave {row.wave}':<16} {row.first_h:5.0f} h "
        f"{row.hours:5.0f} h  {truth}; {row.why}"
    )


def summary(rows: Sequence[RolloutRow]) -> Iterator[str]:
    """Yield how often each scenario ended as it should, by its name and by the true costs."""
    for scenario in SCENARIOS:
        own = [row for row in rows if row.scenario == scenario]
        done = [row for row in own if row.state == "done"]
        first = [row for row in own if row.state == "stopped" and row.wave == 1]
        held = [sum(row.state == "held" and row.wave == wave for row in own) for wave in (1, 2)]
        yield (
            f"{scenario}: stopped in wave 1 in {len(first)} of {len(own)} seeds{_after(first)}, "
            f"held there in {held[0]}, in wave 2 in {held[1]}; reaches all boxes in {len(done)}{_after(done)}"
        )
    harmful = [row for row in rows if max(row.dearer.values()) > SETTINGS.margin]
    harmless = [row for row in rows if max(row.dearer.values()) <= SETTINGS.margin]
    found, wrong = (
        " and ".join(f"{sum(row.state == state for row in rows)} {state}" for state in ("stopped", "held"))
        for rows in (harmful, harmless)
    )
    yield (
        f"by true cost: of {len(harmful)} rollouts that make a kind dearer by over {SETTINGS.margin:.0%}, "
        f"{found}; of {len(harmless)} others {wrong}"
    )


def _after(rows: Sequence[RolloutRow]) -> str:
    return f" after {np.median([row.hours for row in rows]):.0f} h" if rows else ""


def dearer_with_integral(seed: int) -> float:
    """Return by which share the bad bundle makes its kind dearer where a controller has an integral."""
    costs = simulate(seed, LEARNING)
    of_kind = np.array(costs.kinds) == costs.bad_kind
    old, bad = (costs.costs[name][of_kind].mean() for name in LEARNING)
    return float(bad / old - 1.0)


def main(words: Sequence[str] | None = None) -> int:
    """Simulate what is missing, spread the bundles and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleet_rollout", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1, 6)), help="usual: 1 to 5")
    parser.add_argument("--costs", type=Path, default=Path("out") / "fleet_rollout", help="kept costs")
    parser.add_argument(
        "--integral", action="store_true", help="only what the bad bundle costs where a controller learns"
    )
    given = parser.parse_args(words)
    print("\n".join(header()), flush=True)
    if given.integral:
        for seed in given.seeds:
            print(f"{seed:4} {dearer_with_integral(seed):+.1%}", flush=True)
        return 0
    print(f"{'seed':>4} {'bundle':<6} {'ended':<16} {'wave 1':>7} {'in all':>7}  true cost against the old")
    rows: list[RolloutRow] = []
    for seed in given.seeds:
        costs = fleet_costs(seed, given.costs)
        for scenario in SCENARIOS:
            rows.append(roll_out(seed, scenario, costs))
            print(line(rows[-1]), flush=True)
    print("\n".join(summary(rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
