"""The twin that the daemon uses, read by another process: that of the active bundle.

The daemon has checked the bundle's signature; here nothing is run of it, and one file is read.
"""

from dataclasses import dataclass
from pathlib import Path

from edge.bundle.manifest import PACKAGED, TWIN
from edge.bundle.store import BundleStore
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.twin.twin_file import TwinFile, read_twin_file

OF_PAPER = "the packaged bundle"


@dataclass(frozen=True, slots=True)
class ServingTwin:
    """A twin with known values. name : where it is from, in words; own : it is of this rig's box"""

    file: TwinFile
    name: str
    own: bool = True


def serving_twin(settings: Settings, given: Path | None = None) -> ServingTwin:
    """Return the twin of `given`, else of the active bundle.

    Errors : RequestError where there is no twin of this box yet, DataError for one that cannot be read
    """
    if given is not None:
        return ServingTwin(_fully_known(given), str(given))
    if not settings.bundle.path:
        raise RequestError("bundle.path is empty, so no bundle and no twin is used: --twin says which")
    store = BundleStore(Path(settings.bundle.path), Path(settings.bundle.trusted_keys), lambda *_: {})
    version = store.roles().active
    if version != PACKAGED:
        return ServingTwin(_fully_known(store.folder_of(version) / TWIN), f"bundle {version}")
    if settings.box.twin:
        if read_twin_file(Path(settings.box.twin)).to_fit():
            raise RequestError(
                "the active bundle is the packaged one, whose twin is of another box, and "
                f"{settings.box.twin} is not fitted yet: `greenhouse commission` learns it"
            )
        return ServingTwin(_fully_known(Path(settings.box.twin)), settings.box.twin)
    return ServingTwin(_fully_known(store.folder_of(PACKAGED) / TWIN), OF_PAPER, own=False)


def _fully_known(path: Path) -> TwinFile:
    """Return a twin file with every value known. Errors: RequestError, DataError"""
    file = read_twin_file(path)
    if waiting := file.to_fit():
        raise RequestError(f"{path}: {'.'.join(waiting[0])}: is still to be fitted")
    return file
