"""A fleet of made-up rigs that obey orders and have costs, with the database of a real one."""

import hashlib
import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from edge.bundle import remote
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.database.tables import BundleRollout, FleetBundle, FleetRig, RolloutRig, RolloutWave
from fleet.rollout.begin import begin
from fleet.rollout.judge import HOUR_S, HourCost
from fleet.rollout.runner import RolloutRunner
from fleet.rollout.states import News
from fleet.settings import DatabaseSettings, RolloutSettings

ADDRESS = "http://fleet.example/bundles"
SETTINGS = RolloutSettings(address=ADDRESS)
BEGIN_UTC = 500_000 * HOUR_S
ALWAYS = math.inf  # heard at any time
SHA256, VERSION = "ab" * 32, "2.0"


@cache  # drawing takes longer than all else that a runner does
def usual_cost(rig: str, hour: int) -> float:
    """Return what an hour costs a rig without the bundle."""
    seed = int(hashlib.sha256(rig.encode()).hexdigest()[:8], 16)
    noise = np.random.default_rng([seed, hour]).normal(0.0, 0.1)
    return float((1.0 + 0.01 * (seed % 50)) * (2.0 + math.sin(hour * math.pi / 12.0)) * math.exp(noise))


@dataclass
class FleetInMemory:
    """Rigs `<kind>-<number>`. dearer : share by which the bundle makes each kind dearer

    refuses : rigs whose proof fails; silent : rigs that never answer; told : news that wait for a runner
    """

    database: DatabaseSettings
    count: int = 12
    kinds: tuple[str, ...] = ("tent", "case", "cold frame")
    dearer: dict[str, float] = field(default_factory=dict)
    refuses: set[str] = field(default_factory=set)
    silent: set[str] = field(default_factory=set)
    deaf: bool = False
    utc: float = BEGIN_UTC
    told: list[News] = field(default_factory=list)
    heard: list[News] = field(default_factory=list)
    active: dict[str, float] = field(default_factory=dict)
    orders: list[tuple[str, str]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.engine: Engine = open_database(self.database)
        self.lease = FleetLease(self.engine, "rollouts")
        assert self.lease.take() == ""
        with Session(self.engine) as session, session.begin():
            for kind in self.kinds:
                for number in range(self.count):
                    name = f"{kind.replace(' ', '_')}-{number}"
                    session.add(
                        FleetRig(name=name, kind=kind, first_utc=1.0, last_utc=ALWAYS, is_online=True)
                    )
            session.add(
                FleetBundle(
                    sha256=SHA256, version=VERSION, name="models", created_utc="", added_utc=1.0, archive=b"x"
                )
            )
        self.rollout = begin(self.engine, SETTINGS, SHA256, "", self.utc)

    # a line to rigs

    def install(self, rig: str, url: str, sha256: str) -> bool:
        self.orders.append((rig, "install"))
        assert (url, sha256) == (f"{ADDRESS}/{SHA256}.zip", SHA256)
        if rig in self.refuses:
            text = f"{remote.INSTALL} (sha256 {sha256}, asked for): lstm.onnx: golden vector 3 is off"
            self.told.append(News(rig, "bundle.failed", text))
        elif rig not in self.silent:
            self.active.setdefault(rig, self.utc)
            text = f"sha256 {sha256}, asked for; 2.0 is active"
            self.told.append(News(rig, f"bundle.{remote.INSTALL}", text))
        return True

    def roll_back(self, rig: str, version: str) -> bool:
        self.orders.append((rig, "roll back"))
        if rig not in self.silent:
            self.active.pop(rig, None)
            self.told.append(News(rig, f"bundle.{remote.ROLL_BACK}", f"bundle {version}, asked for; 1.0 is"))
        return True

    def hears(self) -> bool:
        return not self.deaf

    def news(self) -> list[News]:
        return list(self.told)

    def confirm(self) -> None:
        self.heard += self.told
        self.told.clear()

    # numbers

    def costs(self, rig: str, since_utc: float, until_utc: float) -> list[HourCost]:
        kind = rig.rpartition("-")[0].replace("_", " ")
        found = []
        for hour in range(math.ceil(since_utc / HOUR_S), math.ceil(until_utc / HOUR_S)):
            cost = usual_cost(rig, hour)
            if hour * HOUR_S >= self.active.get(rig, math.inf):
                cost *= 1.0 + self.dearer.get(kind, 0.0)
            found.append(HourCost(hour * HOUR_S, cost))
        return found

    # a runner

    def run(self, hours: float, look_h: float = 0.5) -> BundleRollout:
        """Look again and again, each time as a runner that was started anew."""
        until = self.utc + hours * HOUR_S
        while self.utc < until and self.state().state == "running":
            self.look()
            self.utc += look_h * HOUR_S
        self.look()
        return self.state()

    def look(self) -> RolloutRunner:
        runner = self.runner()
        self.said += runner.look(self.utc)
        return runner

    def runner(self) -> RolloutRunner:
        return RolloutRunner(self.engine, ADDRESS, self, self.costs, self.lease.check)

    def state(self) -> BundleRollout:
        with Session(self.engine) as session:
            return session.get_one(BundleRollout, self.rollout)

    def wave(self, number: int) -> RolloutWave:
        with Session(self.engine) as session:
            return session.get_one(RolloutWave, (self.rollout, number))

    def rig(self, name: str) -> RolloutRig:
        with Session(self.engine) as session:
            return session.get_one(RolloutRig, (self.rollout, name))
