"""Which bundles the daemon runs: those that the store names, as far as they are whole."""

from collections.abc import Mapping
from dataclasses import dataclass

from edge.bundle.manifest import PACKAGED
from edge.bundle.roles import Roles
from edge.bundle.store import BundleStore, LoadedBundle
from edge.core.errors import DataError, RequestError


@dataclass(frozen=True, slots=True)
class Serving:
    """The models that forecast at each tick. Exchanged whole, never changed."""

    active: LoadedBundle | None  # None: not even the packaged bundle is fit for this rig
    rival: LoadedBundle | None = None  # runs beside it and is scored
    on_probation: bool = False  # the active one is on trial against the rival; else the rival against it
    problems: tuple[str, ...] = ()  # bundles that should serve and can't, with the reason


def choose(store: BundleStore, loaded: Mapping[str, LoadedBundle] | None = None) -> Serving:
    """Choose the active bundle, the previous one if that is damaged, else the packaged one.

    loaded : bundles that are in memory already, by name: they are not read again

    Nothing is written: the store keeps what was asked for, and the next start tries it again.
    """
    problems: list[str] = []

    def load(name: str | None) -> LoadedBundle | None:
        if name is None:
            return None
        try:
            return (loaded or {}).get(name) or store.load(name)
        except (DataError, RequestError) as error:
            problems.append(str(error))
            return None

    try:
        roles = store.roles()
    except DataError as error:
        problems.append(str(error))
        roles = Roles()
    active = load(roles.active)
    if active is not None:
        rival = load(roles.rival)
        return Serving(active, rival, roles.on_probation and rival is not None, tuple(problems))
    # The active bundle may also be the previous one; it is damaged and not read a second time.
    instead = dict.fromkeys((roles.previous, PACKAGED))
    active = next((bundle for name in instead if name != roles.active and (bundle := load(name))), None)
    return Serving(active, problems=tuple(problems))
