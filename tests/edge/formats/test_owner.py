"""edge/formats/owner.py: root follows nobody's links."""

import ast
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

import edge
from edge.formats.atomic_file import (
    hold_lock,
    make_folder,
    open_to_overwrite,
    write_atomically,
    write_document,
)
from edge.formats.input_file import read_file
from edge.formats.owner import COMPANIONS, as_owner, open_database
from edge.page.access import Access, Role
from edge.sockets.stop_file import StopFile
from edge.storage.file import connect

USER = 54321  # of no account
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be led astray")


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A folder of another user's, whom the way there is open to."""
    for folder in (tmp_path, *list(tmp_path.parents)[:-1]):
        folder.chmod(folder.stat().st_mode | 0o011)
    folder = tmp_path / "theirs"
    folder.mkdir()
    os.chown(folder, USER, USER)
    return folder


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file that is root's alone."""
    path = tmp_path / "secret"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE links (name TEXT)")
    path.chmod(0o600)
    return path


USES = {
    "read": lambda path: read_file(path),
    "write": lambda path: write_atomically(path, "x"),
    "overwrite": lambda path: os.close(open_to_overwrite(path)),
    "lock": lambda path: hold_lock(path).__enter__(),
    "database": lambda path: open_database(path).execute("CREATE TABLE x (y)"),
    "database, read": lambda path: open_database(path, "mode=ro").execute("SELECT * FROM links"),
    "history": lambda path: connect(path, 1.0),
    "page": lambda path: Access(path).make_link(Role.VIEW, "x", 1.0),
}


@needs_root
@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_a_link_to_a_file_of_roots_leads_nowhere(theirs: Path, secret: Path, use) -> None:
    before = secret.read_bytes(), secret.stat().st_mode, secret.stat().st_uid
    (theirs / "file").symlink_to(secret)
    with pytest.raises(Exception, match=r"ermission|unable to open|symbolic|links"):
        use(theirs / "file")
    assert (secret.read_bytes(), secret.stat().st_mode, secret.stat().st_uid) == before
    assert read_file(secret) == before[0]  # with root's rights again


@needs_root
def test_a_folder_that_is_a_link_leads_nowhere_too(theirs: Path, tmp_path: Path) -> None:
    (tmp_path / "roots").mkdir(mode=0o755)
    (theirs / "sub").symlink_to(tmp_path / "roots")
    for use in (make_folder, lambda path: write_atomically(path, "x"), lambda path: write_document(path, {})):
        with pytest.raises(PermissionError):
            use(theirs / "sub" / "new")
    with pytest.raises(PermissionError):
        StopFile(theirs / "sub").leave("Ann")
    assert list((tmp_path / "roots").iterdir()) == []


@needs_root
def test_what_root_makes_in_a_folder_is_its_owners(theirs: Path) -> None:
    make_folder(theirs / "sub")
    write_atomically(theirs / "sub" / "file", "x")
    StopFile(theirs / "stops").leave("Ann")
    Access(theirs / "page" / "page.db").open_to_network()
    made = list(theirs.rglob("*"))
    assert len(made) == 6 and {path.stat().st_uid for path in made} == {USER}


@needs_root
def test_links_of_roots_own_lead_on(theirs: Path, tmp_path: Path) -> None:
    (tmp_path / "own").symlink_to(theirs)
    with as_owner(tmp_path / "own" / "file") as is_other:
        assert is_other
    with as_owner(tmp_path / "own") as is_other:
        assert not is_other  # to change the link itself
    with as_owner(theirs / "file"), as_owner(tmp_path / "nothing" / "yet") as is_other:
        assert not is_other


@pytest.mark.parametrize("how", ["", "mode=ro"])
def test_a_database_behind_a_link_to_itself_is_an_error_of_sqlite(tmp_path: Path, how: str) -> None:
    (tmp_path / "file").symlink_to(tmp_path / "file")
    # Found by `python -m bench attack files`: `greenhouse why --history` as root ended in a traceback.
    with pytest.raises(sqlite3.OperationalError, match=r"symbolic links|unable to open"):
        open_database(tmp_path / "file", how)


@needs_root
def test_a_folder_that_others_can_write_to_is_refused(tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    for mode, group in ((0o777, 0), (0o775, USER)):
        (tmp_path / "open").chmod(mode)
        os.chown(tmp_path / "open", 0, group)
        with pytest.raises(sqlite3.OperationalError, match="chmod go-w"):
            open_database(tmp_path / "open" / "file")
        with pytest.raises(PermissionError, match="chmod go-w"), as_owner(tmp_path / "open" / "file"):
            pass
    (tmp_path / "open").chmod(0o1777)  # as /tmp
    with as_owner(tmp_path / "open" / "file") as is_other:
        assert not is_other
    (tmp_path / "open" / "link").symlink_to(tmp_path)
    os.lchown(tmp_path / "open" / "link", USER, USER)
    with as_owner(tmp_path / "open" / "link" / "file") as is_other:
        assert is_other


def test_a_fifo_is_neither_waited_for_nor_kept(tmp_path: Path) -> None:
    for name in ("state.json", "lock", "numbers"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(OSError, match="not a regular file"):
        read_file(tmp_path / "state.json")
    with pytest.raises(OSError, match="No such device"):
        write_atomically(tmp_path / "state.json", "x")  # that nobody reads
    write_document(tmp_path / "state.json", {"a": 1})
    assert read_file(tmp_path / "state.json") == b'{\n "a": 1\n}'
    with hold_lock(tmp_path / "lock"):
        pass
    with pytest.raises(OSError, match="No such device"):
        open_to_overwrite(tmp_path / "numbers")
    for ending in ("", *COMPANIONS):
        os.mkfifo(tmp_path / f"history.db{ending}")
        with pytest.raises(sqlite3.OperationalError, match=f"{ending} is not a regular file"):
            open_database(tmp_path / "history.db")
        (tmp_path / f"history.db{ending}").unlink()


OPENS = {
    *("open", "fdopen", "read_text", "read_bytes", "write_text", "write_bytes", "touch", "mkdir", "makedirs"),
    *("chmod", "chown", "lchown", "rename", "copyfile", "copy2", "copytree", "symlink_to"),
}
OWN = {  # modules that open files themselves, and why root is led nowhere
    "formats/atomic_file.py": "the helper's writer",
    "formats/input_file.py": "the helper's reader",
    "formats/owner.py": "the helper",
    "app/backup.py": "every place by as_owner; the rest in a folder of root's own",
    "storage/file.py": "the log is made longer as_owner",
    "page/access.py": "within as_owner",
    "bundle/store.py": "commands hold as_owner around it",
    "bundle/archive.py": "without links, into a new folder",
    "bundle/adopt.py": "into a new folder",
    "bundle/sign.py": "a new folder; a key is made where there is none",
    "evidence/chain.py": "into a new folder",
    "board/firmware_file.py": "the package's own files, and a new folder",
    "board/board_tool.py": "the package's own files",
    "board/virtual_rig.py": "a demo's own folder",
    "app/running_rigs.py": "a demo's own folder",
    "page/child.py": "a demo's own folder",
    "app/commission_button.py": "the daemon, which is not root",
    "app/nightly_diagnosis.py": "the daemon, which is not root",
    "sockets/unix_socket.py": "the daemon, which is not root",
    "app/daemon.py": "the history, by storage/file.py",
    "storage/archive.py": "the history, by storage/file.py",
    "storage/storage.py": "the history, by storage/file.py",
    "bundle/proof.py": "/proc",
    "page/questions.py": "/proc",
    "core/clock.py": "/proc",
}


def opens(path: Path) -> set[str]:
    """Calls in a file that open one, or change whose it is."""
    calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    methods = {call.attr for call in calls if isinstance(call, ast.Attribute)}
    return (methods & OPENS) | ({"open", "sqlite3.connect"} & {ast.unparse(call) for call in calls})


def test_no_other_module_opens_a_file_by_itself() -> None:
    root = Path(edge.__file__).parent
    found = {str(path.relative_to(root)) for path in root.rglob("*.py") if opens(path)}
    assert found - set(OWN) == set()
    assert set(OWN) - found == set()
