import json
import random
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from edge.mqtt.telemetry import Telemetry
from edge.storage import Outbox
from tests.support.broker import KEEPS_SESSIONS, Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ROOT, ControlLoop, settings

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_reconnect"), needs_mosquitto]
pytest_plugins = ["rig_places"]
TICKS = f"{ROOT}/history/tick"


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


def test_killing_the_daemon_at_any_moment_loses_nothing_that_was_stored(tmp_path):
    database = str(tmp_path / "history.db")
    publisher = str(Path(__file__).parents[3] / "tests" / "support" / "publisher.py")
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
        loop = ControlLoop()
        with closing(Telemetry(settings(broker.port), loop.ask, loop.post, lambda: Outbox(database, ROOT))):
            expected = set(stored(database))
            wait_for(lambda: {seq for _, seq in heard()} >= expected)
