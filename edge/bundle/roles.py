"""Which bundle does what, and how that may change. Pure; a bundle is named by its version.

install -> shadow -> activate -> on probation -> good
              \\-> rejected           \\-> rolled back
"""

from dataclasses import dataclass, field, replace

from edge.bundle.manifest import PACKAGED, Version
from edge.core.errors import RequestError
from edge.formats.cross_check import REQUIRED


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


def rolled_back(roles: Roles) -> Roles:
    """Make the previous bundle active again, without one the packaged. Errors: RequestError"""
    if roles.active == PACKAGED and roles.previous is None:
        raise RequestError("the packaged bundle is active and there is none before it")
    return Roles(roles.previous or PACKAGED, None, roles.shadow)


def marked_good(roles: Roles) -> Roles:
    """Record that the active bundle has proved itself. Errors: RequestError"""
    if not roles.on_probation:
        raise RequestError(f"bundle {roles.active} is not on probation")
    return replace(roles, on_probation=False)


def reject_shadow(roles: Roles) -> Roles:
    """End a shadow that is not better; it stays installed. Errors: RequestError"""
    if roles.shadow is None:
        raise RequestError("no bundle runs in shadow")
    return replace(roles, shadow=None)
