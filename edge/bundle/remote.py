"""Bundles that a fleet orders: fetched from the one place that the settings allow, proved, made active.

Who may write to the broker can at most ask for what a trusted key has signed. The keeper's thread works here.
"""

import hashlib
import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, BinaryIO
from urllib.parse import urlsplit

from edge.bundle.archive import TOTAL_BYTES_MAX
from edge.bundle.manifest import SHA256, VERSION
from edge.bundle.roles import Roles, activate, reject_shadow
from edge.bundle.store import BundleStore
from edge.core.errors import DataError, RequestError
from edge.core.plain_text import quote
from edge.formats.atomic_file import make_folder

if TYPE_CHECKING:  # the package is imported when a bundle is fetched, not with the daemon
    from http.client import HTTPConnection

INSTALL, ROLL_BACK = "remote-install", "remote-rollback"
ACTIONS = (INSTALL, ROLL_BACK)
SILENCE_MAX_S = 30.0  # of the place where bundles are
FETCH_MAX_S = 600.0  # 32 MB over a slow line
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")  # no folder, no query: nothing leads out of the place
_READ_BYTES = 1 << 16

Order = Callable[[BundleStore], Roles]


@dataclass(frozen=True, slots=True)
class BundleSource:
    """The one place of bundles.

    address : "" where nobody may order any; authority : file of a certificate, "" for the system's
    """

    address: str = ""
    authority: str = ""


def install_order(source: BundleSource, url: str | None, sha256: str | None) -> Order:
    """Return what installs and activates a bundle. Errors: RequestError"""
    _check_allowed(source)
    place = source.address.rstrip("/") + "/"
    if not url or not url.startswith(place) or not _NAME.fullmatch(url.removeprefix(place)):
        raise RequestError(f"url: {quote(url)} is no file directly under bundle.source, {place}")
    if sha256 is None or not SHA256.fullmatch(sha256):
        raise RequestError(f"sha256: {quote(sha256)} is no SHA-256 in lower case")
    return partial(_install, url=url, sha256=sha256, authority=source.authority)


def rollback_order(source: BundleSource, version: str | None) -> Order:
    """Return what leaves a bundle, wherever it runs. Errors: RequestError"""
    _check_allowed(source)
    if version is None or not VERSION.fullmatch(version):
        raise RequestError(f"version: {quote(version)} is no version of a bundle")
    return partial(_leave, version=version)


def fetch(url: str, sha256: str, into: BinaryIO, authority: str = "") -> None:
    """Write what stands at an address to a file. No other address is followed.

    authority : file of the certificate that the server's is signed by, "" for the system's
    Errors : DataError for a server that is away, slow or refuses, for too many bytes, another hash
    """
    from http import HTTPStatus
    from http.client import HTTPException

    parts = urlsplit(url)
    give_up_s, size, digest = time.monotonic() + FETCH_MAX_S, 0, hashlib.sha256()
    try:
        line = _line(parts.scheme, parts.hostname or "", parts.port, authority)
        try:
            line.request("GET", parts.path)
            answer = line.getresponse()
            if answer.status != HTTPStatus.OK:
                raise DataError(f"{url}: the server answers {answer.status}")
            while part := answer.read1(_READ_BYTES):
                size += len(part)
                if size > TOTAL_BYTES_MAX:
                    raise DataError(f"{url}: more bytes than a bundle may have, {TOTAL_BYTES_MAX}")
                if time.monotonic() > give_up_s:
                    raise DataError(f"{url}: not fetched after {FETCH_MAX_S:g} s")
                digest.update(part)
                into.write(part)
        finally:
            line.close()
    except (OSError, HTTPException, ValueError) as error:
        raise DataError(f"{url}: {error or type(error).__name__}") from error
    if digest.hexdigest() != sha256:
        raise DataError(f"{url}: its sha256 is {digest.hexdigest()}, the order says {sha256}")


def _line(scheme: str, host: str, port: int | None, authority: str) -> "HTTPConnection":
    import ssl
    from http.client import HTTPConnection, HTTPSConnection

    if scheme == "https":
        try:
            context = ssl.create_default_context(cafile=authority or None)
        except (OSError, ssl.SSLError) as error:
            raise DataError(f"bundle.source_ca: {authority}: {error}") from None
        return HTTPSConnection(host, port, timeout=SILENCE_MAX_S, context=context)
    return HTTPConnection(host, port, timeout=SILENCE_MAX_S)


def _install(store: BundleStore, url: str, sha256: str, authority: str) -> Roles:
    """Fetch, prove, install and activate a bundle; one that is active already stays so. Errors: DataError"""
    try:
        make_folder(store.folder)
        with tempfile.TemporaryFile(dir=store.folder) as archive:  # /tmp may be memory
            fetch(url, sha256, archive, authority)
            version = store.install(archive).version
    except OSError as error:
        raise DataError(f"{error.filename or store.folder}: {error.strerror or error}") from error
    if store.roles().active == version:
        return store.roles()
    return store.change(partial(activate, version=version))


def _leave(store: BundleStore, version: str) -> Roles:
    """Roll back from a bundle, or end its trial; where it does not run, nothing is to do."""
    roles = store.roles()
    if roles.shadow == version:
        roles = store.change(partial(reject_shadow, version=version))
    return store.roll_back(version) if roles.active == version else roles


def _check_allowed(source: BundleSource) -> None:
    if not source.address:
        raise RequestError("bundle.source is empty: this rig takes no orders about bundles from a fleet")
