"""`greenhouse fleet rollout`: begin, watch, let go on, stop and run rollouts of bundles."""

import argparse
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from edge.commands.arguments import add_actions, whole
from fleet.database.base import open_database
from fleet.database.lease import FleetLease, LeaseLost
from fleet.database.tables import BundleRollout
from fleet.rollout.archives import add_archive
from fleet.rollout.begin import begin, go_on_by_person, rigs_of, stop_by_person
from fleet.rollout.blocks import costs_from
from fleet.rollout.overview import newest
from fleet.rollout.rig_line import MqttRigLine
from fleet.rollout.runner import RolloutRunner
from fleet.settings import FleetSettings

LOOK_S = 30.0
WORK = "rollouts"  # of the lease
ACTIONS = {
    "start": "take a signed bundle in and begin to spread it",
    "status": "show rollouts, their waves and rigs",
    "go-on": "let a wave pass that is held: after its time neither harm nor safety is shown",
    "stop": "end a rollout; its rigs roll back",
    "run": "serve rollouts until it is ended: order, judge, go on or roll back",
}


def add_rollout_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions."""
    action = add_actions(parser, ACTIONS)
    for each in action.values():  # where people write it, too
        each.add_argument("--settings", type=Path, default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    action["start"].add_argument("bundle", type=Path, help="archive or folder of the bundle")
    action["start"].add_argument("--group", default="", help="rigs of this group alone; default: all rigs")
    for name, done in {"go-on": "let it go on", "stop": "stopped it"}.items():
        action[name].add_argument("rollout", type=whole(1, 2**63 - 1), help="its number")
        action[name].add_argument("--why", default=f"a person {done}", help="reason, for the record")
    action["status"].add_argument("--rigs", action="store_true", help="a line for each rig too")


def run_rollout(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Carry it out. Errors: GreenhouseError"""
    engine, own = open_database(settings.database), settings.rollout
    match arguments.action:
        case "start":
            sha256 = add_archive(engine, arguments.bundle, Path(own.trusted_keys), time.time())
            number = begin(engine, own, sha256, arguments.group, time.time())
            print(f"rollout {number} begins; `greenhouse fleet rollout run` serves it")
        case "status":
            _show(engine, arguments.rigs)
        case "go-on":
            wave = go_on_by_person(engine, arguments.rollout, arguments.why, time.time())
            print(f"rollout {arguments.rollout}: wave {wave} has passed")
        case "stop":
            stop_by_person(engine, arguments.rollout, arguments.why, time.time())
            print(f"rollout {arguments.rollout} is stopped; its rigs are ordered to roll back")
        case "run":
            _serve(settings, engine)
    return 0


def _serve(settings: FleetSettings, engine: Engine) -> None:
    ended, awake = threading.Event(), threading.Event()

    def end(*_: object) -> None:
        ended.set()
        awake.set()

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, end)
    lease = FleetLease(engine, WORK)
    # The broker knows one runner: a second connection would end the first one's, so it waits for the lease.
    while lease.wait(ended, _say):
        try:
            with lease.keep():
                _look(settings, engine, lease, ended, awake)
        except LeaseLost as error:
            _say(str(error))


def _look(
    settings: FleetSettings, engine: Engine, lease: FleetLease, ended: threading.Event, awake: threading.Event
) -> None:
    """Look again and again until the end. Errors: LeaseLost"""
    line = MqttRigLine(settings.mqtt, awake.set)
    try:
        costs = costs_from(settings.numbers)
        runner = RolloutRunner(engine, settings.rollout.address, line, costs, lease.check, time.time())
        said = ""
        while not ended.is_set():
            for text in runner.look(time.time()):
                print(text, flush=True)
            if runner.problem and runner.problem != said:
                _say(f"no wave is judged: {runner.problem}")
            said = runner.problem
            awake.wait(LOOK_S)
            awake.clear()
    finally:
        line.close()


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _show(engine: Engine, with_rigs: bool) -> None:
    for rollout in reversed(newest(engine, None, time.time())["rollouts"]):
        print(f"rollout {rollout['number']}: bundle {rollout['version']} is {_state(rollout)}")
        for wave in rollout["waves"]:
            print(f"  wave {wave['wave']}: {sum(wave['rigs'].values())} rigs, {_state(wave)}")
            for kind, figures in wave["kinds"].items():
                print(f"    {kind or '-':<16} {_in_words(figures)}")
        if with_rigs:
            with Session(engine) as session:
                for row in rigs_of(session, session.get_one(BundleRollout, rollout["number"])):
                    print(f"  {row.rig:<24} wave {row.wave} {row.state}{f': {row.why}' if row.why else ''}")


def _state(row: Mapping[str, str]) -> str:
    return f"{row['state']}: {row['why']}" if row["why"] else row["state"]


def _in_words(figures: dict[str, float | None]) -> str:
    difference = figures["difference"]
    if difference is None:
        return "nothing could be compared"
    return (
        f"{difference:+.1%} cost over {figures['blocks']} blocks, "
        f"evidence of harm {figures['harm']:.3g}, of no harm {figures['safety']:.3g}"
    )
