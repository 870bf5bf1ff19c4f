"""Archives of bundles: taken in when their signature is right, and handed out to rigs by their hash."""

import hashlib
import tempfile
from pathlib import Path

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from edge.bundle.archive import open_archive, unpack
from edge.bundle.check import check_folder
from edge.core.errors import DataError
from fleet.database.tables import FleetBundle

SUFFIX = ".zip"
BUNDLES = "/bundles"  # of the fleet's page


def add_archive(engine: Engine, source: Path, keys: Path, utc: float) -> str:
    """Take a bundle in and return its SHA-256; its models are proved by the rigs.

    source : archive or folder; keys : folder of trusted public keys
    Errors : DataError for one that is damaged or not signed by a trusted key
    """
    with open_archive(source) as archive, tempfile.TemporaryDirectory(prefix="fleet-bundle-") as folder:
        try:
            unpack(archive, Path(folder))
            manifest = check_folder(Path(folder), keys)
        except DataError as error:
            raise DataError(f"{source}: {error}") from error
        archive.seek(0)
        content = archive.read()
    digest = hashlib.sha256(content).hexdigest()
    with Session(engine) as session, session.begin():
        if session.get(FleetBundle, digest) is None:
            session.add(
                FleetBundle(
                    sha256=digest,
                    version=manifest.version,
                    name=manifest.name,
                    created_utc=manifest.created_utc,
                    added_utc=utc,
                    archive=content,
                )
            )
    return digest


def archive_bytes(engine: Engine, sha256: str) -> bytes | None:
    """Return an archive for a rig, None where there is none of this hash."""
    with Session(engine) as session:
        found = session.get(FleetBundle, sha256)
        return None if found is None else found.archive


def archive_url(address: str, sha256: str) -> str:
    """Return where a rig fetches an archive. address : `rollout.address`, the rig's `bundle.source`"""
    return f"{address.rstrip('/')}/{sha256}{SUFFIX}"
