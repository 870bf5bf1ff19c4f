"""System calls that a unit of systemd allows or refuses by the names of its groups."""

import subprocess
from collections.abc import Mapping, Sequence


def call_groups() -> dict[str, list[str]]:
    """Return the members of each group, as systemd prints them."""
    out = subprocess.run(
        ["systemd-analyze", "syscall-filter"], capture_output=True, text=True, check=True
    ).stdout
    groups: dict[str, list[str]] = {}
    name = ""
    for line in out.splitlines():
        word = line.strip()
        if line.startswith("@"):
            name = word
            groups[name] = []
        elif line.startswith(" ") and name and not word.startswith("#"):
            groups[name].append(word)
        elif not word:
            name = ""
    return groups


def resolved(names: Sequence[str], groups: Mapping[str, list[str]]) -> set[str]:
    """Return the calls of names of which those with an @ are groups."""
    found: set[str] = set()
    for name in names:
        found |= resolved(groups[name], groups) if name.startswith("@") else {name}
    return found
