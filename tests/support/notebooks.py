"""Notebooks run as scripts: no kernel, so no Jupyter among the tests' needs."""

import contextlib
import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def cells_of(notebook: Path) -> list[dict[str, Any]]:
    """Return the cells of a notebook, its texts too."""
    cells: list[dict[str, Any]] = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return cells


def names_left_by(notebook: Path, folder: Path) -> dict[str, Any]:
    """Run a notebook's code in `folder`/examples, beside the manual; return the names it leaves."""
    place = folder / "examples"
    place.mkdir()
    (folder / "docs").symlink_to(ROOT / "docs")
    names: dict[str, Any] = {}
    with contextlib.chdir(place):
        for cell in cells_of(notebook):
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), names)
    return names
