"""The rig's distribution carries no training code, and training's carries all of it."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BUILD = "from setuptools import build_meta; build_meta.build_wheel('wheel')"


def built(project: Path) -> list[str]:
    """Names of the files in the wheel of a project's folder."""
    subprocess.run([sys.executable, "-c", BUILD], cwd=project, check=True, capture_output=True, text=True)
    with zipfile.ZipFile(next((project / "wheel").glob("*.whl"))) as wheel:
        return wheel.namelist()


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy to build in, since a build writes beside the sources."""
    place = tmp_path_factory.mktemp("checkout")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in tracked.splitlines():
        if name.startswith(("training/results/", "docs/", "tests/", "bench/")) or not (ROOT / name).exists():
            continue
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, place / name)
    return place


@pytest.mark.slow
def test_the_rigs_distribution_carries_no_training_code(copy: Path) -> None:
    names = built(copy)
    folders = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert folders == {"edge", "firmware_protocol", "fleet"}
    script = next(name for name in names if name.endswith("entry_points.txt"))
    assert script and "edge/__main__.py" in names and "edge/models/default_arx.json" in names


def test_trainings_distribution_carries_every_module_of_it(copy: Path) -> None:
    names = {name for name in built(copy / "training") if name.endswith(".py")}
    assert names == {
        str(path.relative_to(copy))
        for path in (copy / "training").glob("**/*.py")
        if "build" not in path.parts
    }


def test_no_dependency_of_training_is_one_of_the_rig() -> None:
    rig = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not [
        name for name in rig["dependencies"] if name.startswith(("torch", "stable", "gymnasium", "onnx>"))
    ]
    assert list(rig["scripts"]) == ["greenhouse"]
