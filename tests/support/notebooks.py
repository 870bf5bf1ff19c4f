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


def short_example(folder: Path, runs: int, rows: int) -> None:
    """Lay the first rows of the manual's example of a diagnosis where the manual has all of them."""
    place = folder / "docs" / "examples" / "diagnosis"
    place.mkdir(parents=True)
    given = ROOT / "docs" / "examples" / "diagnosis"
    for path in (*sorted(given.glob("train_*.csv"))[:runs], given / "test_1.csv"):
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        head = next(i for i, line in enumerate(lines) if not line.startswith("#")) + 1
        (place / path.name).write_text("".join(lines[: head + rows]), encoding="utf-8")
    (place / "twin.yaml").write_bytes((given / "twin.yaml").read_bytes())


def names_left_by(notebook: Path, folder: Path) -> dict[str, Any]:
    """Run a notebook's code in `folder`/examples; return the names it leaves.

    Beside it lies the manual, or what of it is in `folder` already.
    """
    place = folder / "examples"
    place.mkdir()
    if not (folder / "docs").exists():
        (folder / "docs").symlink_to(ROOT / "docs")
    names: dict[str, Any] = {}
    with contextlib.chdir(place):
        for cell in cells_of(notebook):
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), names)
    return names
