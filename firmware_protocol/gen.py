"""Writes messages.py and c/gh_messages.h from messages.yaml: `python -m firmware_protocol.gen`."""

import sys
from pathlib import Path

from firmware_protocol.gen_c import c_source
from firmware_protocol.gen_python import python_source
from firmware_protocol.gen_spec import Spec, read_spec

HERE = Path(__file__).parent


def outputs(spec: Spec) -> dict[Path, str]:
    """Return the generated text by path below this folder."""
    return {HERE / "messages.py": python_source(spec), HERE / "c" / "gh_messages.h": c_source(spec)}


def main() -> int:
    """Write both files."""
    for path, text in outputs(read_spec()).items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
