"""The papers of a rig: who it is to the broker, in a file of the fleet's, and what it takes with it."""

import io
import re
import secrets
import tarfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from edge.config.loading import all_problems
from edge.core.errors import RequestError
from edge.formats.atomic_file import make_folder, write_atomically
from edge.formats.cross_check import Section, number, text
from edge.formats.reader import read_yaml
from fleet.machine.authority import Authority, write_secret
from fleet.machine.places import FleetMachine, FleetPlaces
from fleet.rollout.archives import BUNDLES

NAME_OF_RIG = (
    r"[a-zA-Z0-9_-]{1,55}"  # a certificate's name has 64 characters, 9 of which tell two issues apart
)
WORD = r"[a-zA-Z0-9_-]{0,64}"
RESERVED = ("fleet",)
HOME = "/etc/greenhouse/fleet"  # of the papers, on the rig
READ_ME = """Papers of the rig {name} for the fleet at {host}.

On the rig, as root:

    mkdir -p {home} && tar -xzf {name}.tar.gz -C {home}
    chown -R root:greenhouse {home} && chmod 0750 {home} && chmod 0640 {home}/*

Put the section of {home}/mqtt.yaml into /etc/greenhouse/edge.yaml in place of its section mqtt. If the fleet
shall roll out models to this rig, put the two keys of {home}/bundle.yaml into its section bundle. Then

    systemctl restart greenhouse

rig.key is a secret: who has it can speak as this rig, and as no other one.
"""


@dataclass(frozen=True, slots=True)
class RigPaper(Section):
    """The fleet's own file of a rig.

    common_name : drawn anew with each certificate, so that one of an earlier rig of this name has no rights;
        that of its site where it has one
    """

    name: str = text("", "its name in every topic", pattern=NAME_OF_RIG)
    common_name: str = text("", "the broker's name for it", pattern=r"[a-zA-Z0-9_.-]{1,64}")
    group: str = text("", "whose people may see it", pattern=WORD)
    kind: str = text("", "boxes that are built alike share one", pattern=WORD)
    made_utc: float = number(0.0, "when it came in, since 1970", "s", 0.0, 1e12)
    site: str = text("", "whose broker speaks for it; empty: it speaks for itself", pattern=WORD)


def new_paper(name: str, group: str, kind: str, site: str = "", common_name: str = "") -> RigPaper:
    """Return the paper of a new rig. Errors: RequestError for a word that may not stand in a topic

    site, common_name : whose broker speaks for it, and its certificate's name; usual: a name of its own
    """
    own_name = new_common_name(name, "--rigs" if site else "NAME")
    for what, word in (("--group", group), ("--kind", kind)):
        if not re.fullmatch(WORD, word):
            raise RequestError(f"{what}: {word!r} does not match {WORD}")
    return RigPaper(name, common_name or own_name, group, kind, round(time.time(), 1), site)


def new_common_name(name: str, what: str = "NAME") -> str:
    """Return the name of a new certificate. what : the argument that has `name`. Errors: RequestError"""
    if not re.fullmatch(NAME_OF_RIG, name):
        raise RequestError(f"{what}: {name!r} does not match {NAME_OF_RIG}")
    if name in RESERVED:
        raise RequestError(f"{what}: {name!r} is the fleet's own name at the broker")
    return f"{name}.{secrets.token_hex(4)}"


def read_papers(places: FleetPlaces) -> Iterator[RigPaper]:
    """Yield the papers of all rigs, by name. Errors: ConfigError"""
    for path in sorted(places.rigs.glob("*.yaml")):
        with all_problems(path):
            yield read_yaml(RigPaper, path)


def write_paper(places: FleetPlaces, paper: RigPaper) -> None:
    """Write the fleet's own file of a rig. Errors: OSError"""
    make_folder(places.rigs)
    write_atomically(path_of(places, paper.name), yaml.safe_dump(asdict(paper)))


def path_of(places: FleetPlaces, name: str) -> Path:
    """Return the fleet's file of a rig. Errors: RequestError for what is no rig's name"""
    if not re.fullmatch(NAME_OF_RIG, name):
        raise RequestError(f"NAME: {name!r} does not match {NAME_OF_RIG}")
    return places.rigs / f"{name}.yaml"


def rig_files(places: FleetPlaces, machine: FleetMachine, paper: RigPaper) -> dict[str, bytes]:
    """Return what the rig takes with it: the key is made here and stays nowhere else.

    Errors : DataError, OSError
    """
    credential = Authority(places.authority, places.authority_key).for_client(paper.common_name)
    host = machine.names[0]
    mqtt = {
        "enabled": True,
        "host": host,
        "port": machine.ports.broker,
        "tls": True,
        "ca": f"{HOME}/ca.crt",
        "client_cert": f"{HOME}/rig.crt",
        "client_key": f"{HOME}/rig.key",
        "rig": paper.name,
    }
    return {
        "README.txt": READ_ME.format(name=paper.name, host=host, home=HOME).encode(),
        "mqtt.yaml": yaml.safe_dump({"mqtt": mqtt}, sort_keys=False).encode(),
        "bundle.yaml": bundle_section(machine),
        "ca.crt": places.authority.read_bytes(),
        "rig.crt": credential.certificate,
        "rig.key": credential.key,
    }


def bundle_section(machine: FleetMachine) -> bytes:
    """Return a rig's two settings by which it takes bundles from this fleet."""
    bundle = {"source": machine.address + BUNDLES, "source_ca": f"{HOME}/ca.crt"}
    return yaml.safe_dump({"bundle": bundle}, sort_keys=False).encode()


def write_archive(out: Path, files: dict[str, bytes]) -> None:
    """Write files as an archive that only its owner reads. Errors: OSError"""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size, entry.mode, entry.mtime = len(content), 0o600, int(time.time())
            archive.addfile(entry, io.BytesIO(content))
    write_secret(out, packed.getvalue(), 0o600)
