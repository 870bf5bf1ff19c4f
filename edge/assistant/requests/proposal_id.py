"""What a proposal is called: short enough to be typed."""

import secrets

_BYTES = 3
PROPOSAL_ID = f"[0-9a-f]{{{2 * _BYTES}}}"  # a regular expression


def new_id() -> str:
    """Of a new proposal."""
    return secrets.token_hex(_BYTES)
