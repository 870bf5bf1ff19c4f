"""Rigs and sites come in and go: papers, rights at the broker, a row in the database.

A site is the rigs whose papers name it; its broker's certificate is that of each.
"""

import os
import signal
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sqlalchemy import Engine, Table, delete
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.mqtt.telemetry import remove as remove_retained
from fleet.database.base import open_database
from fleet.database.tables import FleetRig, FleetTable
from fleet.machine.places import FleetMachine, FleetPlaces
from fleet.machine.rig_papers import (
    RigPaper,
    new_common_name,
    new_paper,
    path_of,
    read_papers,
    rig_files,
    write_archive,
    write_paper,
)
from fleet.machine.setting_up import write_rights
from fleet.machine.site_papers import site_files
from fleet.numbers.victoria import Numbers, NumbersError
from fleet.settings import FleetSettings, load

SETTLE_S = 0.5  # it looks for signals ten times a second


def add_rig(places: FleetPlaces, name: str, group: str, kind: str, out: Path) -> bool:
    """Let a rig come in, and write what it takes with it; return whether a broker runs that knows it now.

    Errors : RequestError, ConfigError, DataError, OSError
    """
    machine, paper = places.read(), new_paper(name, group, kind)
    return let_in(places, [paper], rig_files(places, machine, paper), out)


def let_in(places: FleetPlaces, papers: Sequence[RigPaper], files: dict[str, bytes], out: Path) -> bool:
    """Let rigs come in, all or none, with one archive; return whether a broker runs that knows them now.

    files : the archive's, by name
    Errors : RequestError for a rig that is in already, ConfigError, DataError, OSError
    """
    here = {paper.name: paper for paper in read_papers(places)}
    for paper in papers:
        if paper.name in here:
            of_site = f" of the site {site}" if (site := here[paper.name].site) else ""
            raise RequestError(
                f"{paper.name} is a rig of this fleet{of_site} already; remove it first to make new papers"
            )
    if out.exists():
        raise RequestError(f"{out} exists already")
    with Session(open_database(load(places.settings).database)) as session, session.begin():
        for paper in papers:
            _list(session, paper)
    # First what goes to the rigs: where that cannot be written, nobody has rights that nobody can use.
    write_archive(out, files)
    for paper in papers:
        write_paper(places, paper)
    write_rights(places)
    return reload_rights(places.read())


def _list(session: Session, paper: RigPaper) -> None:
    known = session.get(FleetRig, paper.name)
    if known is None:
        known = FleetRig(name=paper.name, first_utc=time.time(), last_utc=0.0, is_online=False, state={})
        session.add(known)
    known.group, known.kind = paper.group, paper.kind


def remove_rig(places: FleetPlaces, name: str, erase: bool) -> str:
    """Take a rig's rights away, and its numbers and rows where they are to be erased.

    Returns : what could not be done at the broker, "" for nothing
    Errors : RequestError where there is no such rig; DataError where a store is away, which says what is
        erased: all can be called again until it is through
    """
    places.read()
    settings, path = load(places.settings), path_of(places, name)
    engine = open_database(settings.database) if erase else None
    if not path.exists() and not (engine and _has_row(engine, name)):
        raise RequestError(f"{name} is no rig of this fleet: see `greenhouse fleet rig list`")
    left = take_rights(places, [name])
    if engine:
        erase_rig(engine, Numbers(settings.numbers), name)
    return left


def take_rights(places: FleetPlaces, names: Sequence[str]) -> str:
    """Take the rights of rigs away, all at once, and their retained messages off the broker.

    Returns : what could not be done at the broker, "" for nothing
    Errors : RequestError, ConfigError, OSError
    """
    settings = load(places.settings)
    for name in names:
        path_of(places, name).unlink(missing_ok=True)
    write_rights(places)
    reload_rights(places.read())
    return _forget(settings, names)


def _has_row(engine: Engine, name: str) -> bool:
    with Session(engine) as session:
        return session.get(FleetRig, name) is not None


def erase_rig(engine: Engine, numbers: Numbers, name: str) -> None:
    """Delete a rig's numbers, then its rows. Errors: DataError where a store is away"""
    again = f"call `greenhouse fleet rig remove {name} --erase` again"
    try:
        numbers.erase(name)
    except NumbersError as error:
        raise DataError(
            f"{name} has no rights any more, but its numbers and rows may all be there: {error}; {again}"
        ) from None
    try:  # last: while there is a row, what is left can be erased by its name
        with Session(engine) as session, session.begin():
            for table in reversed(FleetTable.metadata.sorted_tables):
                _erase_rows(session, table, name)
    except SQLAlchemyError as error:
        why = error.__cause__ or error
        raise DataError(
            f"{name} has no rights and no numbers any more, but its rows are all there: {why}; {again}"
        ) from None


def _forget(settings: FleetSettings, names: Sequence[str]) -> str:
    """Take retained messages of rigs off the broker, by the fleet's own rights, as long as it answers."""
    for number, name in enumerate(names):
        try:
            remove_retained(Settings(mqtt=replace(settings.mqtt, rig=name)))
        except RequestError as error:
            return f"what the broker has kept of {', '.join(names[number:])} stays there: {error}"
    return ""


def _erase_rows(session: Session, table: Table, name: str) -> None:
    columns = [key.parent for key in table.foreign_keys if key.target_fullname == "rigs.name"]
    columns += [table.c.name] if table.name == "rigs" else []
    columns += [table.c.rig] if "rig" in table.c and not columns else []
    for column in columns:
        session.execute(delete(table).where(column == name))


def reload_rights(machine: FleetMachine) -> bool:
    """Have the broker read its access list; return whether one runs. Errors: PermissionError"""
    try:
        number = int((Path(machine.data) / "broker" / "mosquitto.pid").read_text())
        if (Path("/proc") / str(number) / "comm").read_text().strip() != "mosquitto":
            return False  # it has ended, and the number is somebody else's
        os.kill(number, signal.SIGHUP)
        # mosquitto 2.0 forgets a signal that comes while it reads: that of another rig's a moment before.
        time.sleep(SETTLE_S)
        os.kill(number, signal.SIGHUP)
    except (FileNotFoundError, ProcessLookupError, ValueError):
        return False
    return True


def read_sites(places: FleetPlaces) -> dict[str, list[RigPaper]]:
    """Return the papers of rigs by the name of their site. Errors: ConfigError"""
    sites: dict[str, list[RigPaper]] = {}
    for paper in read_papers(places):
        if paper.site:
            sites.setdefault(paper.site, []).append(paper)
    return dict(sorted(sites.items()))


def add_to_site(
    places: FleetPlaces, name: str, rigs: Sequence[str], group: str, kind: str, out: Path
) -> tuple[bool, bool]:
    """Let rigs of a site come in, and write what its broker needs for all that it has then.

    A site that is here already keeps its certificate and key, which are in no later archive.

    Returns : whether the site is new; whether a broker runs that knows its rigs now
    Errors : RequestError, ConfigError, DataError, OSError
    """
    machine, here = places.read(), read_sites(places).get(name, [])
    common_name = new_common_name(name)
    if twice := sorted({rig for rig in rigs if rigs.count(rig) > 1}):
        raise RequestError(f"--rigs: {', '.join(twice)} stands there twice")
    if here:
        common_name = here[0].common_name
    papers = [new_paper(rig, group, kind, name, common_name) for rig in rigs]
    every = sorted(paper.name for paper in (*here, *papers))
    files = site_files(places, machine, name, common_name, every, not here)
    return not here, let_in(places, papers, files, out)


def remove_site(places: FleetPlaces, name: str) -> tuple[list[str], str]:
    """Take the rights of a site's rigs away, all at once.

    Returns : the rigs' names; what could not be done at the broker, "" for nothing
    Errors : RequestError where there is no such site, ConfigError, OSError
    """
    places.read()
    rigs = [paper.name for paper in read_sites(places).get(name, [])]
    if not rigs:
        raise RequestError(f"{name} is no site of this fleet: see `greenhouse fleet site list`")
    return rigs, take_rights(places, rigs)
