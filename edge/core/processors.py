"""How many processors there are to share work out among."""

import os


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))
