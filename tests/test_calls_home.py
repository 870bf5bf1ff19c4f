"""Nothing on a rig phones home: models are loaded in an empty network namespace under strace."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from edge.bundle.store import PACKAGED_FOLDER
from edge.models.onnx_predictor import open_session
from tests.support.daemon_process import ROOT

ALONE = ("unshare", "-rn")  # a network namespace of its own, without an address
CAN = shutil.which("strace") is not None and shutil.which(ALONE[0]) is not None
CAN = CAN and subprocess.run([*ALONE, "true"], capture_output=True).returncode == 0
LOAD = """
import time
from pathlib import Path
from edge.bundle.store import BundleStore
from edge.bundle.predictors import loader
nowhere = Path("/nonexistent")
models = BundleStore(nowhere, nowhere, loader(60.0)).load("packaged")
assert {"lstm", "ham"} <= set(models.predictors) and models.policies
time.sleep(2.0)  # time for a thread in the background to look its server up
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def trace(home: Path) -> Sequence[str]:
    """System calls of a process that loads the shipped bundle, by itself in an empty network."""
    if not CAN:
        pytest.skip("needs strace, and leave to make a network namespace")
    calls = home.with_name("calls")
    # no more of the environment: within CI and under pytest telemetry would be suppressed
    environment = {"HOME": str(home), "PATH": os.environ["PATH"], "PYTHONDONTWRITEBYTECODE": "1"}
    environment |= {name: value for name, value in os.environ.items() if name == "PYTHONPATH"}
    program = [
        "strace",
        "-f",
        "-qq",
        "-e",
        "trace=%network,%file",
        "-o",
        str(calls),
        sys.executable,
        "-c",
        LOAD,
    ]
    subprocess.run([*ALONE, *program], cwd=ROOT, env=environment, check=True, timeout=90)
    return calls.read_text().splitlines()


@pytest.mark.slow
def test_loading_the_models_opens_no_socket_but_a_local_one(trace: Sequence[str]) -> None:
    assert any("lstm.onnx" in line for line in trace), "strace saw no model being loaded"
    assert [line for line in trace if re.search(r" (socket|connect|sendto|sendmsg)\((?!AF_UNIX)", line)] == []


def test_loading_the_models_looks_no_name_up(trace: Sequence[str]) -> None:
    assert [
        line for line in trace if re.search(r'"/etc/(resolv\.conf|hosts|nsswitch\.conf|gai\.conf)', line)
    ] == []


@pytest.mark.usefixtures("trace")
def test_loading_the_models_writes_nothing_into_the_home_folder(home: Path) -> None:
    assert list(home.rglob("*")) == []


def test_telemetry_is_disabled_for_an_onnxruntime_that_has_it() -> None:
    """The pinned version has none; a newer one reads this before it loads its first model."""
    open_session((PACKAGED_FOLDER / "lstm.onnx").read_bytes())
    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"
