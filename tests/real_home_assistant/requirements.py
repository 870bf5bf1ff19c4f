"""Prints what integrations of the installed Home Assistant need from PyPI, those they depend on included.

Home Assistant would install it at its first start; done here, a start needs no network.
usage, with Home Assistant's own Python: requirements.py INTEGRATION...
"""

import importlib.util
import json
import sys
from pathlib import Path


def main(names: list[str]) -> None:
    """Print a requirement a line."""
    spec = importlib.util.find_spec("homeassistant")
    assert spec is not None
    assert spec.submodule_search_locations
    components = Path(spec.submodule_search_locations[0]) / "components"
    found, wait = set(), list(names)
    while wait:
        name = wait.pop()
        if name in found:
            continue
        found.add(name)
        path = components / name / "manifest.json"
        if not path.exists():  # another version has it
            continue
        manifest = json.loads(path.read_text())
        print(*manifest.get("requirements", ()), sep="\n")
        wait += manifest.get("dependencies", ())


if __name__ == "__main__":
    main(sys.argv[1:])
