"""`greenhouse bundle`: verify, install, activate, roll back and list bundles of models.

Where a daemon runs, it is asked to change what it serves, so that it does so between two ticks; without one
the store on the disk is changed, and the daemon follows at its next start.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from edge.bundle.archive import open_archive
from edge.bundle.keeper import carry_out
from edge.bundle.manifest import PACKAGED, Manifest
from edge.bundle.predictors import loader
from edge.bundle.proof import Prover
from edge.bundle.roles import Roles
from edge.bundle.store import LOCK, BundleStore
from edge.commands.arguments import add_actions
from edge.commands.which_rig import RIG_CONFIG
from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.formats.owner import as_owner
from edge.sockets.client import NobodyListens, request

POLL_S = 0.1
ACTIONS = {  # action -> help
    "verify": "check signature, hashes and models of a bundle, change nothing",
    "install": "verify a bundle and let it run in shadow beside the active one",
    "activate": "make the bundle in shadow, or VERSION, the active one",
    "rollback": "make the bundle before the active one active again",
    "mark-good": "end the active bundle's probation",
    "reject": "end the shadow's trial; it stays installed",
    "key": "make a key pair that signs bundles",
    "list": "show what is installed, what is active, what runs in shadow",
}
JOB_TIMEOUT_S = 120.0  # for a slow disk and models that load


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--config",
        type=Path,
        default=None,
        help=f"configuration file; default: {RIG_CONFIG} where there is one, else every setting's default",
    )
    action = add_actions(parser, ACTIONS)
    for name in ("verify", "install"):
        action[name].add_argument("bundle", type=Path, help="archive or folder of the bundle")
    action["install"].add_argument(
        "--allow-older", action="store_true", help="accept a version below the newest installed so far"
    )
    # What is installed must be trusted by the daemon too, so by the configuration.
    action["verify"].add_argument(
        "--keys", type=Path, help="folder of trusted public keys (*.pub); default: bundle.trusted_keys"
    )
    action["activate"].add_argument(
        "version", nargs="?", help=f"an installed version, or {PACKAGED}; default: the one in shadow"
    )
    action["key"].add_argument("file", type=Path, help="private key to write; the public one ends in .pub")


def run(arguments: argparse.Namespace) -> int:
    """Carry it out; what is refused is told in one line."""
    if arguments.action == "key":
        return _key(arguments.file)
    settings = settings_of(arguments.config)
    store = store_of(settings, getattr(arguments, "keys", None))
    match arguments.action:
        case "verify":
            _verify(store, arguments.bundle)
        case "install":
            _install(store, settings, arguments.bundle, arguments.allow_older)
        case "list":
            _list(store)
        case action:
            change(store, settings, action, getattr(arguments, "version", None))
    return 0


def store_of(settings: Settings, keys: Path | None = None) -> BundleStore:
    """Return the rig's store. keys : trusted keys in the place of the configured ones"""
    trusted = keys or Path(settings.bundle.trusted_keys)
    step_s = settings.control.step_s
    return BundleStore(Path(settings.bundle.path), trusted, loader(step_s), prove=Prover(trusted, step_s))


def settings_of(path: Path | None) -> Settings:
    """As `--config` says; the rig's file, or every default where there is none. Errors: ConfigError"""
    if path is None and not RIG_CONFIG.exists():
        return config.default()
    return config.load(path or RIG_CONFIG)


def _verify(store: BundleStore, source: Path) -> None:
    with open_archive(source) as archive, _told_of(source):
        manifest = store.verify(archive)
    print(
        f"{source} is good: {manifest.name} {manifest.version} of {manifest.created_utc}, "
        f"{manifest.sample_s:g} s steps, models {', '.join(manifest.models)}{_policies(manifest)}"
    )


def _install(store: BundleStore, settings: Settings, source: Path, allow_older: bool) -> None:
    with open_archive(source) as archive, _told_of(source):
        install(store, settings, archive, allow_older)


def install(store: BundleStore, settings: Settings, archive: BinaryIO, allow_older: bool = False) -> None:
    """Take a bundle in to run in shadow, and tell who serves now. Errors: DataError, RequestError

    allow_older : the operator's word for a version below the newest that was installed
    """
    with as_owner(store.folder / LOCK):
        version = store.install(archive, allow_older).version
    print(f"bundle {version} is installed{' (older versions were allowed)' if allow_older else ''}")
    reply = _ask(settings, "refresh-older" if allow_older else "refresh", version if allow_older else None)
    if reply is None:
        print_roles(store.roles())
    else:
        print_serving(reply)


def change(store: BundleStore, settings: Settings, action: str, version: str | None) -> None:
    """One of `edge.bundle.keeper.ACTIONS`, by the daemon where one runs. Errors: DataError, RequestError"""
    reply = _ask(settings, action, version)
    if reply is not None:
        print_serving(reply)
        return
    with as_owner(store.folder / LOCK):
        roles = carry_out(store, action, version)
    print_roles(roles)


def _key(path: Path) -> int:
    from edge.bundle.sign import generate_key  # late: cryptography

    public = generate_key(path)
    print(f"{path} signs, keep it; {public} goes into the folder of trusted keys of each rig")
    return 0


def _list(store: BundleStore) -> None:
    roles = store.roles()
    for name in [PACKAGED, *store.versions()]:
        words = [word for word, role in _roles_in_words(roles).items() if role == name]
        try:
            loaded = store.load(name)
            state = f"of {loaded.manifest.created_utc}{_policies(loaded.manifest)}"
        except (DataError, RequestError) as error:
            state = f"can't be used: {error}"
        print(f"{name:20} {', '.join(words) or 'installed':24} {state}")


def _policies(manifest: Manifest) -> str:
    return f", policies {', '.join(manifest.policies)}" if manifest.policies else ""


def _roles_in_words(roles: Roles) -> dict[str, str | None]:
    active = "active, on probation" if roles.on_probation else "active"
    return {active: roles.active, "previous": roles.previous, "shadow": roles.shadow}


def print_roles(roles: Roles) -> None:
    """Print each role and its bundle in a line."""
    print("; ".join(f"{word}: {name}" for word, name in _roles_in_words(roles).items() if name))


def print_serving(reply: dict[str, Any]) -> None:
    """Print the roles as the daemon has them."""
    probation = ", on probation" if reply["on_probation"] else ""
    print(f"active: {reply['active']}{probation}; beside it: {reply['rival'] or 'none'} (the daemon has it)")
    for problem in reply["problems"]:
        print(f"the daemon can't use: {problem}")


def _ask(settings: Settings, action: str, version: str | None) -> dict[str, Any] | None:
    """Return the daemon's state after the job, None where no daemon runs.
    Errors: RequestError for a refusal
    """
    socket = Path(settings.control_socket.path)
    try:
        job = _accept(request(socket, {"do": "bundle", "action": action, "version": version}))["job"]
    except NobodyListens:
        return None
    give_up_s = time.monotonic() + JOB_TIMEOUT_S
    while time.monotonic() < give_up_s:
        reply = _accept(request(socket, {"do": "bundle", "action": "status", "job": job}))
        if reply["job_error"]:
            raise RequestError(reply["job_error"])
        if reply["job_done"]:
            return reply
        time.sleep(POLL_S)
    raise RequestError(f"the daemon is not done with {action} after {JOB_TIMEOUT_S:g} s")


def _accept(reply: dict[str, Any]) -> dict[str, Any]:
    if not reply.get("ok", False):
        raise RequestError(str(reply.get("error", reply)))
    return reply


@contextmanager
def _told_of(source: Path) -> Iterator[None]:
    """Errors begin with the bundle's file."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{source}: {error}") from error
    except OSError as error:  # of the place where it is unpacked
        raise DataError(f"{source}: {error.filename}: {error.strerror or error}") from error
