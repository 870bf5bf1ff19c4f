"""edge/formats/atomic_file.py: the file before or the new one, whole, and nothing else."""

import errno
import multiprocessing
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from edge.formats import atomic_file
from edge.formats.atomic_file import write_atomically

ROOT = Path(__file__).parent.parent.parent.parent
OLD, NEW = b"old" * 1000, b"new" * 2_000_000


@pytest.fixture(params=["without a name", "with a name"])
def file_system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that has files without a name, and one that has not."""
    if request.param == "with a name":
        opened = os.open

        def refuse(path: str, flags: int, *arguments: int, **more: int) -> int:
            if flags & os.O_TMPFILE == os.O_TMPFILE:
                raise OSError(errno.EOPNOTSUPP, "Operation not supported")
            return opened(path, flags, *arguments, **more)

        monkeypatch.setattr(os, "open", refuse)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.usefixtures("file_system")
def test_a_file_is_made_and_replaced_and_nothing_else_is_there(tmp_path: Path) -> None:
    path = tmp_path / "twin.yaml"
    write_atomically(path, OLD)
    write_atomically(path, "wärmer\n")
    assert path.read_bytes() == "wärmer\n".encode()
    assert names(tmp_path) == ["twin.yaml"]


@pytest.mark.usefixtures("file_system")
def test_the_mode_of_the_file_before_stays_and_a_new_one_follows_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "new", b"")
    finally:
        os.umask(before)
    (tmp_path / "old").write_bytes(OLD)
    (tmp_path / "old").chmod(0o604)
    write_atomically(tmp_path / "old", b"")
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("new", "old")] == [0o640, 0o604]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_the_owner_of_the_file_before_stays(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(OLD)
    os.chown(path, 1234, 4321)
    write_atomically(path, NEW)
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 4321)


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there" / "file")
    write_atomically(tmp_path / "link", NEW)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there" / "file").read_bytes() == NEW


def test_a_fifo_is_written_and_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    reader = os.open(tmp_path / "fifo", os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(tmp_path / "fifo", b"a,b\n")
    assert os.read(reader, 10) == b"a,b\n"
    os.close(reader)


@pytest.mark.parametrize("call", ["fsync", "rename", "link"])
def test_a_disk_that_refuses_is_reported_with_the_path_and_leaves_the_file_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def refuse(*arguments: object, **more: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "twin.yaml"
    path.write_bytes(OLD)
    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OSError, match=r"No space left on device: .*twin\.yaml'") as caught:
        write_atomically(path, NEW)
    assert caught.value.filename == str(path)
    assert path.read_bytes() == OLD
    assert names(tmp_path) == ["twin.yaml"]


@pytest.mark.parametrize("name", ["missing/file", "folder", "n" * 256])
def test_a_place_that_cannot_hold_a_file_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError) as caught:
        write_atomically(tmp_path / name, NEW)
    assert caught.value.filename == str(tmp_path / name)
    assert names(tmp_path) == ["folder"]


def test_the_content_is_on_the_disk_before_its_name_and_the_name_when_the_call_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []

    def noted(name: str) -> None:
        real = getattr(os, name)

        def call(*arguments: object, **more: object) -> object:
            is_folder = name == "fsync" and stat.S_ISDIR(os.fstat(arguments[0]).st_mode)
            calls.append("fsync folder" if is_folder else name)
            return real(*arguments, **more)

        monkeypatch.setattr(os, name, call)

    for name in ("fsync", "link", "rename"):
        noted(name)
    write_atomically(tmp_path / "file", NEW)
    assert calls == ["fsync", "link", "rename", "fsync folder"]


def test_a_kill_while_the_disk_is_slow_leaves_the_file_before_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_bytes(OLD)
    program = (
        "import os, sys, time\nfrom pathlib import Path\nfrom edge.formats import atomic_file\n"
        "os.fsync = lambda file: (print(flush=True), time.sleep(60.0))\n"
        "atomic_file.write_atomically(Path(sys.argv[1]), b'new' * 2_000_000)\n"
    )
    command = [sys.executable, "-c", program, str(path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.kill()
    assert path.read_bytes() == OLD
    assert names(tmp_path) == ["diagnosis.json"]


def _write_for_ever(path: Path, content: bytes) -> None:
    while True:
        write_atomically(path, content)


@pytest.mark.slow
def test_a_reader_sees_one_whole_file_whatever_two_killed_writers_did(tmp_path: Path) -> None:
    path, contents = tmp_path / "report.html", (OLD * 200, NEW[: 3 * 100_000])
    path.write_bytes(OLD * 200)
    spawn = multiprocessing.get_context("fork")
    writers = [spawn.Process(target=_write_for_ever, args=(path, content)) for content in contents]
    for writer in writers:
        writer.start()
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        assert path.read_bytes() in contents
    for writer in writers:
        assert writer.pid is not None
        os.kill(writer.pid, signal.SIGKILL)
        writer.join()
    assert path.read_bytes() in contents
    write_atomically(path, NEW)
    assert names(tmp_path) == ["report.html"]  # not even the second name of a writer killed while it used it


def test_no_other_file_of_the_project_renames_or_synchronises() -> None:
    alone = {
        "edge/formats/atomic_file.py",
        "edge/app/backup.py",  # a history of gigabytes is streamed, not handed over as a whole
        "edge/storage/numbers.py",  # overwrites in place: a full disk has no room for a new file
        "edge/sockets/unix_socket.py",  # a socket is not a file with content
    }
    found = {
        str(path.relative_to(ROOT))
        for part in ("edge", "training", "bench")
        for path in (ROOT / part).rglob("*.py")
        if any(word in path.read_text() for word in ("os.fsync(", ".rename(", "os.replace(", "mkstemp("))
    }
    assert found == alone
    assert Path(atomic_file.__file__).is_relative_to(ROOT)
