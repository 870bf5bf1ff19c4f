"""edge/bundle/signature.py: the daemon checks signatures without loading the library for it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from edge.bundle.store import PACKAGED_FOLDER

CHECK = """
import subprocess, sys
from pathlib import Path
from edge.bundle.check import check_folder
if {fails}:
    def no_process(*_, **__): raise OSError("no process")
    subprocess.run = no_process
try:
    print(check_folder(Path({folder!r}), Path({folder!r}) / "keys").name)
except Exception as error:
    print(type(error).__name__, error)
print("cryptography" in sys.modules)
"""


def checked(folder: Path, fails: bool = False) -> list[str]:
    """Return a fresh process's verdict on a bundle, and whether it loaded the library."""
    program = CHECK.format(folder=str(folder), fails=fails)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return Path(shutil.copytree(PACKAGED_FOLDER, tmp_path / "bundle"))


def test_a_good_bundle_is_taken_without_loading_the_library(bundle: Path) -> None:
    said, is_loaded = checked(bundle)
    assert "Error" not in said
    assert is_loaded == "False"


def test_a_changed_manifest_is_refused_with_the_reason(bundle: Path) -> None:
    with (bundle / "manifest.json").open("ab") as file:
        file.write(b" ")
    said, is_loaded = checked(bundle)
    assert said.startswith("DataError the signature is by none of the 1 trusted keys")
    assert is_loaded == "False"


def test_a_key_that_cannot_be_read_is_named(bundle: Path) -> None:
    keys = bundle / "keys"
    keys.mkdir()
    (keys / "rig.pub").write_text("no key")
    said, _ = checked(bundle)
    assert "rig.pub: is no Ed25519 public key" in said


def test_where_no_process_can_be_started_the_signature_is_checked_all_the_same(bundle: Path) -> None:
    said, is_loaded = checked(bundle, fails=True)
    assert "Error" not in said
    assert is_loaded == "True"
    with (bundle / "manifest.json").open("ab") as file:
        file.write(b" ")
    assert checked(bundle, fails=True)[0].startswith("DataError the signature is by none")
