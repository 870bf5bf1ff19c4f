"""The fleet's own broker as a process, with the files that the fleet writes; clients at it by certificate."""

import ssl
import subprocess
import tarfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from edge.core.processes import die_with_parent, end_process
from fleet.machine.engines import engines
from fleet.machine.places import FleetPlaces, places_of
from fleet.machine.setting_up import set_up
from tests.support.broker import PATIENCE_S, wait_for
from tests.support.page_process import listens


class FleetBroker:
    """`with FleetBroker(tmp_path) as broker:` a fleet of which only the broker runs."""

    def __init__(self, folder: Path) -> None:
        self.places = places_of(folder / "fleet")
        self.machine = set_up(self.places, ["localhost"], True, lambda words: None)
        self._log = folder / "broker.log"
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start, and wait until it listens."""
        engine = next(engines(self.places, self.machine))
        with self._log.open("ab") as file:
            process = subprocess.Popen(engine.command, stdout=file, stderr=file, preexec_fn=die_with_parent)
        self._process = process
        wait_for(lambda: listens(engine.port) or process.poll() is not None, "the broker")
        assert process.poll() is None, self.log

    def stop(self) -> None:
        """End in good order."""
        if self._process is not None:
            end_process(self._process, PATIENCE_S)
            self._process = None

    @property
    def log(self) -> str:
        """Its output so far."""
        return self._log.read_text(errors="replace")


def unpacked(archive: Path) -> Path:
    """Unpack papers into a folder of the archive's name; return the folder."""
    home = archive.with_name(archive.name.removesuffix(".tar.gz"))
    with tarfile.open(archive) as packed:
        packed.extractall(home, filter="data")
    return home


def context(home: Path, name: str = "rig") -> ssl.SSLContext:
    """Return TLS by unpacked papers. name : of certificate and key, without their endings"""
    found = ssl.create_default_context(cafile=str(home / "ca.crt"))
    found.load_cert_chain(home / f"{name}.crt", home / f"{name}.key")
    return found


def fleets_context(places: FleetPlaces) -> ssl.SSLContext:
    """Return TLS by the fleet's own certificate."""
    found = ssl.create_default_context(cafile=str(places.authority))
    found.load_cert_chain(places.certificate("fleet"), places.key("fleet"))
    return found


@contextmanager
def connected(port: int, tls: ssl.SSLContext, name: str) -> Iterator[Client]:
    """A client at the broker. Its publications' reason codes are in `answers` of its user data."""
    ready = threading.Event()
    client = Client(CallbackAPIVersion.VERSION2, name, protocol=MQTTProtocolVersion.MQTTv5, userdata={})
    client.tls_set_context(tls)
    client.on_connect = lambda client, *_: ready.set()
    client.on_publish = lambda client, answers, mid, code, more: answers.update({mid: str(code)})
    client.connect("localhost", port)
    client.loop_start()
    try:
        assert ready.wait(PATIENCE_S)
        yield client
    finally:
        client.disconnect()
        client.loop_stop()


def answer(client: Client, topic: str) -> str:
    """Publish, and return the broker's word on it."""
    mid = client.publish(topic, b"{}", qos=1).mid
    wait_for(lambda: mid in client.user_data_get(), f"an answer to {topic}")
    return str(client.user_data_get()[mid])
