"""Orders to the store, from a person or from the scores: one table for the command line and the daemon."""

from collections.abc import Callable
from functools import partial

from edge.bundle.roles import Roles, activate, marked_good, reject_shadow
from edge.bundle.store import BundleStore
from edge.core.errors import RequestError

Action = Callable[[BundleStore, str | None], Roles]


def _activate(store: BundleStore, version: str | None) -> Roles:
    return store.change(partial(activate, version=version))


def _roll_back(store: BundleStore, version: str | None) -> Roles:
    return store.roll_back()


def _mark_good(store: BundleStore, version: str | None) -> Roles:
    return store.change(marked_good)


def _reject(store: BundleStore, version: str | None) -> Roles:
    return store.change(reject_shadow)


def _refresh(store: BundleStore, version: str | None) -> Roles:
    return store.roles()


ACTIONS: dict[str, Action] = {
    "activate": _activate,
    "rollback": _roll_back,
    "mark-good": _mark_good,
    "reject": _reject,
    "refresh": _refresh,  # changes nothing: the daemon reads again what others have changed
    "refresh-older": _refresh,  # the same after `install --allow-older VERSION`, for the event
}


def carry_out(store: BundleStore, action: str, version: str | None) -> Roles:
    """Do one of ACTIONS. Errors: RequestError, DataError; nothing has changed then."""
    if action not in ACTIONS:
        raise RequestError(f"action: {action!r} is none of {', '.join(ACTIONS)}")
    return ACTIONS[action](store, version)
