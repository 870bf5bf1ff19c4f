"""Sites come in and go. A site is the rigs whose papers name it; its broker's certificate is that of each."""

from collections.abc import Sequence
from pathlib import Path

from edge.core.errors import RequestError
from fleet.machine.places import FleetPlaces
from fleet.machine.rig_papers import RigPaper, new_common_name, new_paper, read_papers
from fleet.machine.rig_register import let_in, take_rights
from fleet.machine.site_papers import site_files


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
