"""A bundle like the one before but with another twin: how what a diagnosis found gets to run.

A hybrid corrects one twin and no other, so it is left out until it is trained on the new one.
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.bundle.manifest import SHA256, TWIN, Manifest
from edge.bundle.roles import ADOPTED
from edge.bundle.sign import ManifestFacts, sign_folder
from edge.bundle.store import BundleStore
from edge.core.errors import DataError, RequestError
from edge.core.version import __version__
from edge.formats.atomic_file import write_atomically
from edge.formats.reader import parse_json, read_bytes
from edge.models.pbm import read_twin
from edge.twin.twin_file import TwinFile, read_twin_file

REPORT = "report.json"
_BASE_CHARS = 50  # of the version before, so that the new one is no longer than a version may be


@dataclass(frozen=True, slots=True)
class AdoptedBundle:
    """A bundle that was made: from which one, and which of its models it lacks."""

    manifest: Manifest
    base: str
    dropped: tuple[str, ...]


def with_twin(store: BundleStore, twin: Path, created_utc: str, key: Path, folder: Path) -> AdoptedBundle:
    """Fill the empty `folder` with the active bundle's models and `twin`, signed.

    The same twin on the same bundle gives the same manifest, so adopting it twice installs it once.

    twin : file with every value known
    created_utc : of the bundle where the twin's provenance does not say when it was made
    key : private key whose public half the rig trusts
    Errors : DataError for a twin that is not fit or of another step, a damaged bundle, a wrong key;
        RequestError for the twin that is running already
    """
    active = store.load(store.roles().active)
    before, base = active.manifest, store.folder_of(active.name)
    new, file = read_twin(twin).twin, read_twin_file(twin)
    running = read_twin(base / before.models["pbm"].file).twin if "pbm" in before.models else None
    if running is not None and running.sha256 == new.sha256:
        raise RequestError(f"{twin}: is the twin of bundle {active.name}, which is active, already")
    if new.step_s != before.sample_s:
        raise DataError(
            f"{twin}: sample_s: {new.step_s:g}, but bundle {active.name} is for {before.sample_s:g} s"
        )
    # A HAM is a correction of one twin; over another it would correct errors that are not there.
    stale = before.twin_sha256 != new.sha256
    dropped = tuple(name for name in before.models if name == "ham" and stale)
    left_out = {before.models[name].file for name in (*dropped, "pbm") if name in before.models} | {TWIN}
    for name in before.files:
        if name not in left_out:
            shutil.copyfile(base / name, folder / name)
    shutil.copyfile(twin, folder / TWIN)
    _note(folder / REPORT, {"from": before.version, "left_out": list(dropped)})
    version = f"{ADOPTED.sub('', before.version)[:_BASE_CHARS]}-twin-{new.sha256[:8]}"
    facts = ManifestFacts(
        version,
        str(file.provenance.get("created_utc", created_utc)),
        _data_sha256(file, before),
        before.sample_s,
        before.name,
        dict(before.software) | {"greenhouse-twin": __version__},
    )
    return AdoptedBundle(sign_folder(folder, facts, key), active.name, dropped)


def _data_sha256(file: TwinFile, before: Manifest) -> str:
    """Return the hash of the runs that the twin was fitted on, else of the former models' runs."""
    told = file.provenance.get("data_sha256")
    return told if isinstance(told, str) and SHA256.fullmatch(told) else before.data_sha256


def _note(path: Path, adopted: dict[str, Any]) -> None:
    """Say it in the report of the models, where there is one."""
    try:
        report = parse_json(read_bytes(path))
    except DataError:
        report = {}
    write_atomically(path, json.dumps({**report, "adopted_twin": adopted}, indent=1) + "\n")
