"""Makes or renews the folder of a fleet: authority, certificates, files of the engines, database."""

import os
import pwd
import secrets
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from edge.core.errors import RequestError
from edge.formats.atomic_file import make_folder, write_atomically
from fleet.database.base import open_database
from fleet.machine.alarm_rules import alarm_rules
from fleet.machine.authority import Authority, is_fresh, make_authority, write_secret
from fleet.machine.engine_files import broker_file, settings_file, web_file
from fleet.machine.places import (
    DATA,
    FOLDER,
    LOCAL,
    USER,
    FleetMachine,
    FleetPlaces,
    free_ports,
    own_host_names,
)
from fleet.machine.rig_papers import read_papers
from fleet.machine.rights import access_list
from fleet.settings import load

Tell = Callable[[str], None]
STORES = ("broker", "numbers", "web", "log")


def set_up(places: FleetPlaces, names: Sequence[str], is_try: bool, tell: Tell) -> FleetMachine:
    """Make what is missing, renew what ends soon, write the engines' files anew; fleet.yaml stays.

    names : by which others reach this machine, none for its own
    is_try : by whoever calls, on this machine alone, at ports that are free
    Errors : RequestError, ConfigError, DataError, OSError
    """
    machine = _machine(places, names, is_try)
    for store in STORES:
        make_folder(Path(machine.data) / store)
    make_folder(places.bundle_keys)
    _certify(places, machine, tell)
    if not places.alert_token.exists():
        write_secret(places.alert_token, secrets.token_urlsafe(32).encode())
    if not places.settings.exists():
        write_atomically(places.settings, settings_file(places, machine))
    settings = load(places.settings)
    unknown = [name for name in machine.names if name not in ("localhost", LOCAL, *settings.page.names)]
    if unknown:
        tell(f"{places.settings}: page.names lacks {', '.join(unknown)}: browsers are refused by that name")
    write_atomically(places.broker, broker_file(places, machine))
    write_atomically(places.web, web_file(places, machine))
    write_atomically(places.rules, alarm_rules(settings.alarms))
    write_rights(places)
    open_database(settings.database).dispose()
    return machine


def write_rights(places: FleetPlaces) -> None:
    """Write the broker's access list from the papers of the rigs. Errors: OSError, ConfigError"""
    write_atomically(places.rights, access_list(read_papers(places)))


def _machine(places: FleetPlaces, names: Sequence[str], is_try: bool) -> FleetMachine:
    if not places.machine.exists():
        if places.folder.exists() and any(places.folder.iterdir()):
            raise RequestError(
                f"{places.folder} holds other files and is no fleet's folder: choose another one"
            )
        make_folder(places.folder)
        data = DATA if places.folder == FOLDER else places.folder / "data"
        known = own_host_names(names)
        if is_try:
            user = pwd.getpwuid(os.geteuid()).pw_name
            found = FleetMachine(str(data), user, LOCAL, known, free_ports())
        else:
            found = FleetMachine(str(data), USER, "", known)
        places.write(found)
        return found
    found = places.read()
    if names and found.names != own_host_names(names):
        found = replace(found, names=own_host_names(names))
        places.write(found)
    return found


def _certify(places: FleetPlaces, machine: FleetMachine, tell: Tell) -> None:
    if not places.authority.exists():
        made = make_authority(f"Greenhouse fleet of {machine.names[0]}"[:64])
        write_secret(places.authority_key, made.key, 0o600)
        write_atomically(places.authority, made.certificate)
        tell(f"made the authority {places.authority}")
    authority = Authority(places.authority, places.authority_key)
    if not is_fresh(places.certificate("server"), machine.names):
        made = authority.for_server(machine.names)
        made.write(places.certificate("server"), places.key("server"))
        tell(f"made the server's certificate for {', '.join(machine.names)}")
    if not is_fresh(places.certificate("fleet")):
        authority.for_client("fleet").write(places.certificate("fleet"), places.key("fleet"))
