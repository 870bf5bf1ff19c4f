"""Which bundle does what, and how that may change. Pure; a bundle is named by its version.

install -> shadow -> activate -> on probation -> good
              \\-> rejected           \\-> rolled back
"""

import re
from dataclasses import dataclass, field, replace

from edge.bundle.manifest import PACKAGED, Version
from edge.core.errors import RequestError
from edge.formats.cross_check import REQUIRED

ADOPTED = re.compile(r"-twin-[0-9a-f]{8}$")  # end of a version that `edge.bundle.adopt` has made


def is_adopted(version: str | None) -> bool:
    """Return whether a bundle of this version was made for a twin that a diagnosis found."""
    return version is not None and ADOPTED.search(version) is not None


@dataclass(frozen=True, slots=True)
class Roles:
    """The default is a rig on which nothing was ever installed."""

    active: Version = field(default=PACKAGED, metadata=REQUIRED)
    previous: Version | None = None  # active before, and good
    shadow: Version | None = None  # forecasts beside the active one and is scored
    # The active one is new and has to prove itself against the previous.
    on_probation: bool = field(default=False, metadata=REQUIRED)

    @property
    def rival(self) -> str | None:
        """The bundle that runs beside the active one to be compared with it."""
        return self.previous if self.on_probation else self.shadow


def add_shadow(roles: Roles, version: str) -> Roles:
    """Put a new bundle in shadow; a bundle in use stays as it is."""
    if version in (roles.active, roles.rival):
        return roles
    return replace(roles, shadow=version)


def activate(roles: Roles, version: str | None) -> Roles:
    """`version`, or the shadow, becomes active and is on probation. Errors: RequestError"""
    version = version or roles.shadow
    if version is None:
        raise RequestError("no bundle runs in shadow: say which version to activate")
    if version == roles.active:
        raise RequestError(f"bundle {version} is active already")
    if roles.on_probation and version == roles.previous:
        return rolled_back(roles)
    shadow = None if version == roles.shadow else roles.shadow
    # One that is still on probation is no bundle to fall back to.
    previous = roles.previous if roles.on_probation else roles.active
    return Roles(version, previous, shadow, on_probation=True)


def rolled_back(roles: Roles, version: str | None = None) -> Roles:
    """Make the previous bundle active again, without one the packaged. Errors: RequestError

    version : that is to be left; None whichever is active
    """
    _check_still(version, roles.active, "active")
    if roles.active == PACKAGED and roles.previous is None:
        raise RequestError("the packaged bundle is active and there is none before it")
    return Roles(roles.previous or PACKAGED, None, roles.shadow)


def back_to(roles: Roles) -> str | None:
    """Return the bundle that a roll back makes active, None where there is none."""
    try:
        return rolled_back(roles).active
    except RequestError:
        return None


def marked_good(roles: Roles) -> Roles:
    """Record that the active bundle has proved itself. Errors: RequestError"""
    if not roles.on_probation:
        raise RequestError(f"bundle {roles.active} is not on probation")
    return replace(roles, on_probation=False)


def reject_shadow(roles: Roles, version: str | None = None) -> Roles:
    """End a shadow that is not better; it stays installed. Errors: RequestError

    version : of that shadow; None whichever it is
    """
    if roles.shadow is None:
        raise RequestError("no bundle runs in shadow")
    _check_still(version, roles.shadow, "in shadow")
    return replace(roles, shadow=None)


def last_adopted(roles: Roles) -> str | None:
    """Return the bundle of the twin that was adopted last and runs, None where there is none."""
    return next((version for version in (roles.shadow, roles.active) if is_adopted(version)), None)


def _check_still(version: str | None, now: str, role: str) -> None:
    """Refuse an order that somebody gave who saw another bundle in this role. Errors: RequestError"""
    if version not in (None, now):
        raise RequestError(f"bundle {version} is not {role} any more: {now} is")
