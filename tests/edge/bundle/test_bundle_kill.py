"""kill -9 at every system call of install and activate; and what is synced before and after a rename.

One process prepares everything and forks a child for each point. strace kills at a child's n-th call of a
kind; child k makes k such calls that do not matter first, so it dies at call n - k of the work itself.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bundles import Workshop, install, load_nothing

from edge.bundle.keeper import carry_out, choose
from edge.bundle.manifest import PACKAGED
from edge.bundle.store import BundleStore

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed"),
]

WORK = """
import os, sys
from pathlib import Path
import cryptography  # signatures are checked in this process then: a pipe to another is no call of the store
sys.path[:0] = [{tests!r}]
from bundles import install, load_nothing
from edge.bundle.keeper import carry_out
from edge.bundle.keeper import choose
from edge.bundle.store import BundleStore

folder, kind, children = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])

def store(place):
    return BundleStore(place, folder / "trusted", load_nothing, folder / "packaged")

def work(place):
    install(store(place), folder / "2.0.zip")
    carry_out(store(place), "activate", None)

def waste(scratch, number):
    if kind == "mkdir":
        os.mkdir(scratch / str(number))
    elif kind in ("rename", "renameat", "linkat"):
        place = os.open(scratch, os.O_RDONLY)
        (scratch / "x").touch()
        (scratch / "y").unlink(missing_ok=True)
        if kind == "rename":
            os.rename(scratch / "x", scratch / "y")
        else:
            call = os.link if kind == "linkat" else os.rename
            call("x", "y", src_dir_fd=place, dst_dir_fd=place)
    else:
        with (scratch / "x").open("wb") as file:
            file.write(b"x") if kind == "write" else os.fsync(file.fileno())

choose(store(folder / "before"))  # what is imported late is there before the children are
ended = []
for number in range(children):
    child = os.fork()
    if child == 0:
        for i in range(number):
            waste(folder / f"scratch-{{number}}", i)
        work(folder / f"{{kind}}-{{number}}")
        os._exit(0)
    _, status = os.waitpid(child, 0)
    ended.append(os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status))
print(" ".join(str(how) for how in ended))
"""


def prepare(folder: Path) -> Workshop:
    """A store in which 1.0 is active and good, and a bundle 2.0 on its way."""
    workshop = Workshop(folder)
    workshop.signed_folder("packaged", version="0")
    store = store_at(workshop, folder / "before")
    install(store, workshop.archive("1.0"))
    carry_out(store, "activate", None)
    carry_out(store, "mark-good", None)
    workshop.archive("2.0")
    return workshop


def store_at(workshop: Workshop, folder: Path) -> BundleStore:
    return BundleStore(folder, workshop.trusted, load_nothing, workshop.folder / "packaged")


def run(folder: Path, kind: str, children: int, strace: list[str]) -> list[int]:
    """Return the signal or exit code that ended each child; child k's store is `<kind>-<k>`."""
    for number in range(children):
        shutil.copytree(folder / "before", folder / f"{kind}-{number}")
        (folder / f"scratch-{number}").mkdir()
    program = WORK.format(tests=str(Path(__file__).parents[2] / "support"))
    words = [sys.executable, "-B", "-c", program, str(folder), kind, str(children)]
    done = subprocess.run(
        ["strace", "-f", "-qq", *strace, *words],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
        timeout=60,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return [int(word) for word in done.stdout.split()]


# Calls of each kind that the work makes: five files, admitted.json and twice roles.json, each with its
# folder, and the new folder with its own. Only the new folder is renamed by its path.
@pytest.mark.parametrize(
    ("kind", "calls"),
    [("fsync", 18), ("rename", 1), ("renameat", 8), ("linkat", 8), ("mkdir", 1), ("write", 8)],
)
def test_a_kill_at_any_call_leaves_a_working_bundle(tmp_path: Path, kind: str, calls: int) -> None:
    workshop = prepare(tmp_path)
    inject = [
        "-o",
        "/dev/null",
        "-e",
        f"trace={kind}",
        "-e",
        f"inject={kind}:signal=SIGKILL:when={calls + 1}",
    ]
    ended = run(tmp_path, kind, calls + 1, inject)
    # Child 0 makes the work's calls only and must survive, or there are more calls than this test kills at.
    assert ended[0] == 0, "the work makes more calls than are tested"
    assert set(ended[1:]) == {9}, "the work makes fewer calls than are tested"
    for number in range(len(ended)):
        store = store_at(workshop, tmp_path / f"{kind}-{number}")
        serving = choose(store)
        assert serving.problems == ()
        assert serving.active is not None
        assert serving.active.name in ("1.0", "2.0")
        for version in store.versions():
            store.load(version)  # there is no half of a bundle
        # The next attempt clears up and gets through.
        install(store, tmp_path / "2.0.zip")
        if store.roles().active != "2.0":
            carry_out(store, "activate", "2.0")
        names = sorted(path.name for path in store.folder.iterdir())
        assert names == ["1.0", "2.0", "admitted.json", "lock", "roles.json"]
        assert choose(store).active.name == "2.0"


def test_everything_is_synced_before_the_rename_that_names_it_and_the_folder_after(tmp_path: Path) -> None:
    prepare(tmp_path)
    trace = tmp_path / "trace"
    kinds = "trace=write,fsync,rename,renameat,linkat"
    run(tmp_path, "trace", 1, ["-y", "-o", str(trace), "-e", kinds])
    place = tmp_path / "trace-0"
    calls = [line.split(" ", 1)[1].strip() for line in trace.read_text().splitlines() if str(place) in line]
    links = [i for i, call in enumerate(calls) if call.startswith("linkat(")]
    renames = [i for i, call in enumerate(calls) if call.startswith(("rename(", "renameat("))]
    assert (
        len(links) == 8
    )  # five files, admitted.json, and roles.json for the shadow and for the active bundle
    for at in links:
        file = re.search(r'"/proc/self/fd/(\d+)"', calls[at]).group(1)
        last_write = max(i for i in range(at) if calls[i].startswith(f"write({file}<"))
        assert any(call.startswith(f"fsync({file}<") for call in calls[last_write:at]), calls[at]
    assert len(renames) == len(links) + 1  # and the bundle's folder
    for at in renames:
        after = calls[at + 1 : next((i for i in renames if i > at), None)]
        if calls[at].startswith("renameat("):
            folder = path_of(calls[at])
        else:
            source, target = (Path(name) for name in re.findall(r'"([^"]+)"', calls[at]))
            folder = target.parent
            assert source.name == ".incoming"
            assert synced(calls[at - 1 : at], source), "the bundle's folder is renamed before it is synced"
        assert synced(after[:3], folder), f"the folder of {calls[at]} is not synced after the rename"


def path_of(call: str) -> Path:
    """The file that the call's first descriptor stands for."""
    return Path(re.search(r"<([^>]+)>", call).group(1))


def synced(calls: list[str], path: Path) -> bool:
    return any(call.startswith("fsync(") and path_of(call) == path for call in calls)


# The rename of the bundle's folder, and that of admitted.json after five files.
@pytest.mark.parametrize(("kind", "when"), [("rename", 1), ("renameat", 6)])
def test_a_kill_before_anything_was_installed_leaves_the_packaged_bundle(
    tmp_path: Path, kind: str, when: int
) -> None:
    workshop = prepare(tmp_path)
    shutil.rmtree(tmp_path / "before")
    (tmp_path / "before").mkdir()
    inject = ["-o", "/dev/null", "-e", f"trace={kind}", "-e", f"inject={kind}:signal=SIGKILL:when={when}"]
    assert run(tmp_path, kind, 1, inject) == [9]
    assert choose(store_at(workshop, tmp_path / f"{kind}-0")).active.name == PACKAGED
