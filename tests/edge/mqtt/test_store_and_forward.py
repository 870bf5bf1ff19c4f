import json
import random
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from bench.support.broker import KEEPS_SESSIONS, Broker, Listener, needs_mosquitto, wait_for
from bench.support.mqtt_rig import ROOT, ControlLoop, record, settings
from edge.config.settings import HistorySettings
from edge.core.clock import RealClock
from edge.mqtt.telemetry import Telemetry
from edge.storage import Outbox, Storage

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_reconnect"), needs_mosquitto]
pytest_plugins = ["rig_places"]
TICKS = f"{ROOT}/history/tick"


def publishing(broker, database):
    outbox = lambda: Outbox(database, ROOT)  # noqa: E731
    return closing(Telemetry(settings(broker.port), ControlLoop().ask, ControlLoop().post, outbox))


def stored(database):
    with closing(sqlite3.connect(database)) as connection_:
        return [seq for (seq,) in connection_.execute("SELECT seq FROM ticks WHERE seq > 0 ORDER BY seq")]


class Heard:
    """Ticks that a listener has, each once; a message is read once, however often a wait asks."""

    def __init__(self, listener):
        self._listener, self._read, self._ticks = listener, 0, {}

    def __call__(self):
        new = self._listener.heard[self._read :]
        self._read += len(new)
        ticks = (json.loads(message.payload) for message in new if message.topic == TICKS)
        self._ticks.update({(tick["history_id"], tick["seq"]): None for tick in ticks})
        return list(self._ticks)


def test_ticks_of_an_outage_arrive_in_order_once_the_broker_is_back(tmp_path):
    database = str(tmp_path / "history.db")
    storage = Storage(HistorySettings(path=database), RealClock())
    first = storage.open()
    with (
        closing(storage),
        Broker(tmp_path, KEEPS_SESSIONS) as broker,
        Listener(broker.port, TICKS) as listener,
        publishing(broker, database) as own,
    ):
        heard = Heard(listener)
        wait_for(lambda: not own.faults())
        broker.stop()
        for number in range(300):
            storage.write(record(first + number, utc=1.7e9 + 60 * number))
        assert storage.wait_written(first + 299, 20)
        broker.start()
        wait_for(lambda: len(heard()) == 300)
        assert [seq for _, seq in heard()] == stored(database)
        assert len({history for history, _ in heard()}) == 1
        with closing(Outbox(database, ROOT)) as outbox:
            wait_for(lambda: outbox.depth() == 0)


def test_killing_the_daemon_at_any_moment_loses_nothing_that_was_stored(tmp_path):
    database = str(tmp_path / "history.db")
    publisher = str(Path(__file__).parents[3] / "bench" / "support" / "publisher.py")
    moments = random.Random(5)
    with Broker(tmp_path, KEEPS_SESSIONS) as broker, Listener(broker.port, TICKS) as listener:
        heard = Heard(listener)
        for _ in range(4):
            process = subprocess.Popen(
                [sys.executable, publisher, str(broker.port), database],
                env={"PYTHONPATH": str(Path(__file__).parents[3])},
            )
            try:
                before = len(heard())
                some = moments.randrange(1, 300)
                wait_for(lambda before=before, some=some: len(heard()) >= before + some)
            finally:
                process.kill()
                process.wait()
        with publishing(broker, database):
            expected = set(stored(database))
            wait_for(lambda: {seq for _, seq in heard()} >= expected)
