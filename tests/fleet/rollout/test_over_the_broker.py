"""A rollout over a real broker: rigs fetch, prove and obey, and a runner that is killed goes on."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from bundles import Workshop, make_store
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.bundle import remote
from edge.bundle.keeper import BundleKeeper
from edge.bundle.remote import BundleSource
from edge.config.settings import MqttSettings
from edge.core.clock import RealClock
from edge.core.errors import DataError
from edge.mqtt.telemetry import Telemetry
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.database.tables import BundleRollout, FleetRig, RolloutRig
from fleet.rollout.archives import add_archive, archive_bytes
from fleet.rollout.begin import begin, stop_by_person
from fleet.rollout.rig_line import MqttRigLine
from fleet.rollout.runner import RolloutRunner
from fleet.settings import DatabaseSettings, RolloutSettings
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ControlLoop, MemoryOutbox, record, settings

pytestmark = needs_mosquitto
pytest_plugins = ["rig_places"]
RIGS = ("rig-1", "rig-2")


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path)


@contextmanager
def serving_archives(engine: Engine) -> Iterator[str]:
    """Address of the fleet's archives."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            content = archive_bytes(engine, self.path.removeprefix("/bundles/").removesuffix(".zip"))
            self.send_response(404 if content is None else 200)
            self.end_headers()
            self.wfile.write(content or b"")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/bundles"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class ObeyingRig:
    """The part of a daemon that obeys a fleet: telemetry and the keeper of bundles."""

    def __init__(self, name: str, port: int, keeper: BundleKeeper) -> None:
        self.keeper = keeper
        self.telemetry = Telemetry(
            replace(settings(port), mqtt=replace(settings(port).mqtt, rig=name)),
            keeper.answer,
            ControlLoop().post,
            MemoryOutbox,
        )

    def tick(self) -> None:
        """Hand out what the keeper told, as the loop does."""
        if events := self.keeper.events_pending():
            self.telemetry.write(record(events=tuple(events)))

    def close(self) -> None:
        self.telemetry.close()
        self.keeper.close()


def fleet_database(folder: Path) -> Engine:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{folder}/fleet.db"))
    with Session(engine) as session, session.begin():
        for name in RIGS:
            session.add(FleetRig(name=name, kind="tent", first_utc=1.0, last_utc=time.time(), is_online=True))
    return engine


def states(engine: Engine) -> dict[str, str]:
    with Session(engine) as session:
        return {row.rig: row.state for row in session.scalars(select(RolloutRig))}


@pytest.mark.usefixtures("quick_reconnect")
def test_rigs_obey_a_rollout_and_its_end_over_the_broker(workshop: Workshop, tmp_path: Path) -> None:
    engine = fleet_database(tmp_path)
    sha256 = add_archive(engine, workshop.archive("2.0"), workshop.trusted, 1.0)
    with Broker(tmp_path) as broker, serving_archives(engine) as at, ExitStack() as stack:
        rigs = {}
        for name in RIGS:
            (tmp_path / name).mkdir()
            store = make_store(replace_folder(workshop, tmp_path / name))
            source = BundleSource(at)
            keeper = BundleKeeper(store, RealClock(), automatic=False, trial_ticks=10, source=source)
            rigs[name] = ObeyingRig(name, broker.port, keeper)
            stack.callback(rigs[name].close)
        line = MqttRigLine(MqttSettings(host="127.0.0.1", port=broker.port, rig="fleet"))
        stack.callback(line.close)
        number = begin(engine, RolloutSettings(address=at), sha256, "", time.time())
        lease = FleetLease(engine, "rollouts")
        assert lease.take() == ""
        runner = RolloutRunner(engine, at, line, lambda *_: [], lease.check)

        def look(rig_state: str, count: int) -> bool:
            for rig in rigs.values():
                rig.tick()
            runner.look(time.time())
            return list(states(engine).values()).count(rig_state) == count

        wait_for(lambda: look("active", 1), "a rig of the first wave has obeyed", 60.0)
        (first,) = states(engine)
        active = rigs[first].keeper.serving.active
        assert active is not None and active.name == "2.0"
        stop_by_person(engine, number, "enough", time.time())
        wait_for(lambda: look("rolled back", 1), "the rig has rolled back", 60.0)
        active = rigs[first].keeper.serving.active
        assert active is not None and active.name == "packaged"
    engine.dispose()


def replace_folder(workshop: Workshop, folder: Path) -> Workshop:
    """A workshop with the same keys, whose store is elsewhere."""
    other = object.__new__(Workshop)
    for name, value in (("folder", folder), ("key", workshop.key), ("trusted", workshop.trusted)):
        object.__setattr__(other, name, value)
    return other


def test_an_archive_that_no_trusted_key_signed_is_not_taken_in(workshop: Workshop, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    foreign = Workshop(tmp_path / "other").archive("2.0")
    engine = fleet_database(tmp_path)
    with pytest.raises(DataError, match="by none of the"):
        add_archive(engine, foreign, workshop.trusted, 1.0)
    assert archive_bytes(engine, "0" * 64) is None
    engine.dispose()


def test_a_runner_that_is_killed_hears_what_rigs_said_meanwhile(workshop: Workshop, tmp_path: Path) -> None:
    engine = fleet_database(tmp_path)
    sha256 = add_archive(engine, workshop.archive("2.0"), workshop.trusted, 1.0)
    number = begin(engine, RolloutSettings(address="http://fleet.example/b"), sha256, "", time.time())
    with Broker(tmp_path) as broker, Listener(broker.port, "greenhouse/+/set/#") as rig:
        path = tmp_path / "fleet.yaml"
        path.write_text(
            f'database: {{url: "sqlite:///{tmp_path}/fleet.db"}}\n'
            "rollout: {address: http://fleet.example/b}\n"
            f"mqtt: {{enabled: true, host: 127.0.0.1, port: {broker.port}, rig: fleet}}\n"
        )
        command = [sys.executable, "-m", "edge", "fleet", "rollout", "run", "--settings", str(path)]
        with subprocess.Popen(command) as runner:
            try:
                wait_for(lambda: rig.heard, "the order of the first wave", 60.0)
            finally:
                runner.send_signal(signal.SIGKILL)
        assert runner.wait() == -signal.SIGKILL
        (order,) = rig.heard
        name = order.topic.split("/")[1]
        assert json.loads(order.payload) == {"url": f"http://fleet.example/b/{sha256}.zip", "sha256": sha256}
        assert states(engine) == {name: "ordered"}
        text = f"sha256 {sha256}, asked for; 2.0 is active"
        rig.send(f"greenhouse/{name}/event", json.dumps({"key": f"bundle.{remote.INSTALL}", "text": text}))
        with subprocess.Popen(command) as runner:
            try:
                wait_for(lambda: states(engine) == {name: "active"}, "the next runner has heard it", 60.0)
            finally:
                runner.send_signal(signal.SIGTERM)
                assert runner.wait(30.0) == 0
    with Session(engine) as session:
        assert session.get_one(BundleRollout, number).state == "running"
    engine.dispose()
