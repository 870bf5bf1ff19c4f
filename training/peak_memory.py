"""The most memory that a training needed."""

import resource
from pathlib import Path

_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")
_RESET_PEAK = "5"  # man 5 proc, clear_refs


def reset_peak() -> None:
    """Count from now on, where the system can (Linux); elsewhere the peak is that of the whole process."""
    if _CLEAR.exists():
        _CLEAR.write_text(_RESET_PEAK)


def peak_rss_mib() -> float:
    """Largest resident memory of this process [MiB]."""
    if _STATUS.exists():
        lines = _STATUS.read_text().splitlines()
        found = next((line for line in lines if line.startswith("VmHWM:")), None)
        if found is not None:
            return int(found.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
