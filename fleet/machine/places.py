"""Files and folders of a fleet, the ports of its engines, and the names by which others reach it."""

import re
import socket
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import yaml

from edge.config.loading import all_problems
from edge.core.errors import RequestError
from edge.formats.address import host_problem
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Section, items, text, whole
from edge.formats.reader import read_yaml

FOLDER = Path("/etc/greenhouse-fleet")
DATA = Path("/var/lib/greenhouse-fleet")
USER = "greenhouse-fleet"
LOCAL = "127.0.0.1"
HTTPS = 443
HOST = r"[a-zA-Z0-9.:_-]{1,64}"


@dataclass(frozen=True, slots=True)
class Ports(Section):
    """TCP ports. Only the broker's and the web's are reached from elsewhere."""

    broker: int = whole(8883, "mosquitto, MQTT over TLS", 1, 65535)
    web: int = whole(443, "caddy, the page over https", 1, 65535)
    numbers: int = whole(8430, "VictoriaMetrics", 1, 65535)
    alerts: int = whole(8431, "vmalert", 1, 65535)
    page: int = whole(8432, "the page, behind caddy", 1, 65535)


@dataclass(frozen=True, slots=True)
class FleetMachine(Section):
    """All of `machine.yaml`, which `greenhouse fleet up` writes."""

    data: str = text("", "folder of the database, the numbers and the broker's store")
    user: str = text(USER, "user as whom the engines run", pattern=r"[a-z_][a-z0-9_-]{0,31}")
    host: str = text("", "address at which broker and web listen; empty: all", form=host_problem)
    names: tuple[str, ...] = items("names of this machine, in the server's certificate", "fleet.example.org")
    ports: Ports = field(default_factory=Ports)

    @property
    def address(self) -> str:
        """The page, without a slash at the end."""
        name, port = self.host or self.names[0], self.ports.web
        return f"https://{name}" if port == HTTPS else f"https://{name}:{port}"

    def cross_check(self) -> None:
        """Check that every name may stand in a certificate."""
        for name in self.names:
            if not re.fullmatch(HOST, name):
                self.refuse("names", f"{name!r} is neither a host name nor an address")
        if not self.names:
            self.refuse("names", "at least one is needed")


@dataclass(frozen=True, slots=True)
class _Place:
    """A file or folder of a fleet's folder, by its name."""

    name: str

    def __get__(self, places: "FleetPlaces", owner: type) -> Path:
        return places.folder / self.name


@dataclass(frozen=True, slots=True)
class FleetPlaces:
    """Files below the folder of the fleet's settings."""

    folder: Path

    machine = _Place("machine.yaml")  # by which a folder is known to be a fleet's
    settings = _Place("fleet.yaml")  # of ingest and page
    authority = _Place("ca.crt")  # certificate of the authority
    authority_key = _Place("ca.key")  # which no engine reads
    bundle_keys = _Place("keys")  # folder of public keys whose bundles may be rolled out
    alert_token = _Place("alerts.token")  # the word by which vmalert shows the page who it is
    rules = _Place("alerts.yaml")  # of vmalert
    broker = _Place("mosquitto.conf")
    rights = _Place("mosquitto.acl")  # topics that each may read and write
    web = _Place("Caddyfile")
    rigs = _Place("rigs")  # folder with a file for each rig that may come in
    lock = _Place("up.lock")  # held by `fleet up --foreground`, with its process number

    def certificate(self, name: str) -> Path:
        """Return the place of a certificate: `server` or `fleet`."""
        return self.folder / f"{name}.crt"

    def key(self, name: str) -> Path:
        """Return the place of its key."""
        return self.folder / f"{name}.key"

    def read(self) -> FleetMachine:
        """Return what `up` has written. Errors: RequestError without any, ConfigError for a bad file"""
        if not self.machine.exists():
            raise RequestError(f"{self.folder} is no fleet's folder: there is no {self.machine.name} in it")
        with all_problems(self.machine):
            return read_yaml(FleetMachine, self.machine)

    def write(self, machine: FleetMachine) -> None:
        """Write it. Errors: OSError"""
        write_atomically(self.machine, HEAD + yaml.safe_dump(asdict(machine) | {"names": [*machine.names]}))


HEAD = "# Written by `greenhouse fleet up`; after a change call it again.\n"


def own_host_names(given: Iterable[str]) -> tuple[str, ...]:
    """Return names for the certificate: those that are given, or this machine's; and the loopback's."""
    host = socket.gethostname()
    names = [*given] or [socket.getfqdn(), host, f"{host.partition('.')[0]}.local"]
    known = [name for name in dict.fromkeys(names) if re.fullmatch(HOST, name) and name != "localhost"]
    return (*known, *(name for name in ("localhost", LOCAL) if name not in known))


def free_ports() -> Ports:
    """Return ports that nobody listens at now: of several tries none takes another's."""
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in fields(Ports)]
        for probe in probes:
            probe.bind(("", 0))
        return Ports(*(int(probe.getsockname()[1]) for probe in probes))


def is_free(port: int) -> bool:
    """Return whether nobody listens at a port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("", port))
        except OSError:
            return False
        return True


def places_of(folder: Path) -> FleetPlaces:
    """Return the places below a folder, absolute."""
    return FleetPlaces(folder.absolute())
