"""Ids of proposals, short enough to type."""

import secrets

_BYTES = 3
PROPOSAL_ID = f"[0-9a-f]{{{2 * _BYTES}}}"  # a regular expression


def new_id() -> str:
    """Return a new id."""
    return secrets.token_hex(_BYTES)
