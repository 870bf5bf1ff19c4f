"""The programs of a fleet: how each is started, and by which port it is known to be ready."""

import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from edge.core.errors import RequestError
from fleet.machine.places import LOCAL, FleetMachine, FleetPlaces

PACKAGES = {  # program -> Debian package
    "mosquitto": "mosquitto",
    "victoria-metrics": "victoria-metrics",
    "vmalert": "victoria-metrics",
    "caddy": "caddy",
}
WORK_AT = "03:00"  # local time
RETENTION = "3650d"  # as numbers.retention_days


@dataclass(frozen=True, slots=True)
class Engine:
    """A program. port : it listens there once it is ready, 0 where it does not listen

    low_port : it may have a port below 1024
    """

    name: str
    words: str
    command: tuple[str, ...]
    port: int = 0
    environment: Mapping[str, str] = field(default_factory=dict)
    low_port: bool = False


def engines(places: FleetPlaces, machine: FleetMachine, python: str = sys.executable) -> Iterator[Engine]:
    """Yield the programs in the order in which they start. Errors: RequestError for one that is missing"""
    ports = machine.ports
    ours = (python, "-P", "-m", "edge", "fleet")
    yield Engine(
        "broker", "mosquitto, the broker", (_program("mosquitto"), "-c", str(places.broker)), ports.broker
    )
    numbers = (
        _program("victoria-metrics"),
        f"-storageDataPath={machine.data}/numbers",
        f"-httpListenAddr={LOCAL}:{ports.numbers}",
        # A tick that was stored twice, after a kill, is one: the same time and the same value.
        "-dedup.minScrapeInterval=1ms",
        f"-retentionPeriod={RETENTION}",
        "-snapshotsMaxAge=1d",  # one that a kill of ingest left behind
        "-search.latencyOffset=1s",  # else the newest half a minute is not shown
        "-memory.allowedPercent=30",
        "-loggerLevel=WARN",
    )
    yield Engine("numbers", "VictoriaMetrics, the numbers", numbers, ports.numbers)
    settings = ("--settings", str(places.settings))
    yield Engine("ingest", "from the broker to numbers and database", (*ours, "ingest", *settings))
    yield Engine("page", "the page and its API", (*ours, "serve", *settings), ports.page)
    yield Engine("rollouts", "bundles in waves", (*ours, "rollout", *settings, "run"))
    yield Engine("work", "the jobs of a night", (*ours, "work", "--at", WORK_AT, *settings))
    alerts = (
        _program("vmalert"),
        f"-rule={places.rules}",
        f"-datasource.url=http://{LOCAL}:{ports.numbers}",
        f"-notifier.url=http://{LOCAL}:{ports.page}",
        f"-notifier.bearerTokenFile={places.alert_token}",
        f"-httpListenAddr={LOCAL}:{ports.alerts}",
        "-loggerLevel=WARN",
    )
    yield Engine("alerts", "vmalert, the alarms", alerts, ports.alerts)
    web = (_program("caddy"), "run", "--config", str(places.web), "--adapter", "caddyfile")
    home = f"{machine.data}/web"
    kept = {"HOME": home, "XDG_DATA_HOME": home, "XDG_CONFIG_HOME": home}
    yield Engine("web", "caddy, https in front of the page", web, ports.web, kept, low_port=True)


def _program(name: str) -> str:
    found = shutil.which(name) or shutil.which(name, path="/usr/sbin:/usr/local/sbin:/sbin")
    if found is None:
        raise RequestError(f"{name} is missing: apt install {PACKAGES[name]}")
    return found
