"""All installed bundles: when each was made, what is in it, and which role it has."""

from dataclasses import dataclass, field

from edge.bundle.adopt import REPORT
from edge.bundle.manifest import PACKAGED, TWIN
from edge.bundle.roles import back_to, last_adopted
from edge.bundle.store import BundleStore
from edge.core.errors import DataError, RequestError
from edge.core.plain_text import plain
from edge.formats.input_file import MODEL
from edge.formats.reader import Foreign, read_json
from edge.twin.twin_file import read_twin_file

PROBLEM_MAX = 300  # characters


@dataclass(frozen=True, slots=True)
class AdoptionNote(Foreign):
    """Part of a bundle's report, see `edge.bundle.adopt`."""

    base: str = field(default="", metadata={"key": "from"})


@dataclass(frozen=True, slots=True)
class ModelReport(Foreign):
    """The part of report.json that says where a bundle comes from."""

    adopted_twin: AdoptionNote = field(default_factory=AdoptionNote)


@dataclass(frozen=True, slots=True)
class InstalledBundle:
    """A bundle in the store.

    effects : of its twin; adopted_from : bundle that it was made of for another twin, "" for one that was not
    problem : why it can't be used, "" where its signature and hashes are right
    """

    version: str
    name: str = ""
    created_utc: str = ""
    models: tuple[str, ...] = ()
    policies: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    adopted_from: str = ""
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Inventory:
    """ordered : active by the store, though another one may serve in its place
    back_to : bundle that a roll back makes active; undo : bundle that undoing the last adoption leaves
    """

    bundles: tuple[InstalledBundle, ...] = ()
    ordered: str | None = None
    shadow: str | None = None
    back_to: str | None = None
    undo: str | None = None


def take_inventory(store: BundleStore, before: Inventory) -> Inventory:
    """Look at all bundles. What is known from `before` is not read again: a version never changes.

    Never raises: what is damaged is told with its bundle.
    """
    known = {bundle.version: bundle for bundle in before.bundles if not bundle.problem}
    bundles = tuple(known.get(name) or _look(store, name) for name in (PACKAGED, *store.versions()))
    try:
        roles = store.roles()
    except DataError:  # the keeper tells it as a problem of what serves
        return Inventory(bundles)
    return Inventory(bundles, roles.active, roles.shadow, back_to(roles), last_adopted(roles))


def _look(store: BundleStore, version: str) -> InstalledBundle:
    try:
        manifest, files = store.read_bundle(version)
        effects = tuple(read_twin_file(files / TWIN).effects)
        has_report = REPORT in manifest.files
        report = read_json(ModelReport, files / REPORT, MODEL) if has_report else ModelReport()
    except (DataError, RequestError, OSError) as error:
        return InstalledBundle(version, problem=plain(str(error), PROBLEM_MAX))
    return InstalledBundle(
        version,
        manifest.name,
        manifest.created_utc,
        tuple(manifest.models),
        tuple(manifest.policies),
        effects,
        report.adopted_twin.base,
    )
