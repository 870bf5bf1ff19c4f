"""Facts of a rig for each sealed day: settings, wiring, bundle, software and machine."""

import platform
from pathlib import Path
from typing import Any

from edge.bundle.manifest import MANIFEST, PACKAGED
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.config.loading import config_hash
from edge.config.settings import Settings
from edge.core.errors import DataError
from edge.core.version import __version__
from edge.evidence.chain_files import sha256
from edge.formats.input_file import SMALL, read_text


def rig_facts(config: Path, settings: Settings, store: BundleStore) -> dict[str, Any]:
    """Return plain values. A file that cannot be read is a fact too."""
    files = {path.name: _text(path) for path in (config, config.parent / "board.yaml") if path.exists()}
    return {
        "software": __version__,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {platform.system()} {platform.release()}",
        "config_sha256": config_hash(settings),
        "bundle": _bundle(store),
        "files": files,
    }


def _text(path: Path) -> str:
    try:
        return read_text(path, SMALL >> 2)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _bundle(store: BundleStore) -> str:
    """Return the active bundle and the SHA-256 of its manifest."""
    try:
        active = store.roles().active
        folder = PACKAGED_FOLDER if active == PACKAGED else store.folder_of(active)
        return f"{active}, manifest {sha256((folder / MANIFEST).read_bytes())}"
    except (DataError, OSError) as error:
        return f"cannot be read: {error}"
