"""Stores and publishes ticks, some hundred a second, until it is killed: publisher.py PORT DATABASE."""

import sys
import time

from edge.config.settings import HistorySettings
from edge.core.clock import RealClock
from edge.mqtt.telemetry import Telemetry
from edge.storage import Outbox, Storage
from tests.support.mqtt_rig import ROOT, ControlLoop, record, settings

port, database = int(sys.argv[1]), sys.argv[2]
storage = Storage(HistorySettings(path=database), RealClock())
seq = storage.open()
telemetry = Telemetry(settings(port), ControlLoop().ask, ControlLoop().post, lambda: Outbox(database, ROOT))
while True:
    storage.write(record(seq, utc=1.7e9 + seq))
    seq += 1
    time.sleep(0.003)
