"""edge/app/backup.py: a rig goes on elsewhere from one file; a damaged one changes nothing."""

import io
import json
import socket
import sqlite3
import tarfile
import threading
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from edge.app.backup import MANIFEST, back_up, restore
from edge.commands import backup as command
from edge.core.errors import DataError, RequestError
from edge.storage import FactBook
from edge.storage.file import connect

FILES = {
    "etc/credentials/secret_mqtt": "hunter2",
    "etc/page-credentials/mail": "hunter3",
    "etc/keys/mine.pub": "key",
    "etc/twin.yaml": "learned",
    "etc/twin.yaml.before": "described",
    "var/evidence/chain.jsonl": "{}",
    "var/state.json": "{}",
    "var/bundles/1.2/manifest.json": "{}",
    "var/bundles/roles.json": '{"active": "1.2"}',
    "var/diagnosis/night.html": "<p>",
}


@pytest.fixture
def rig(tmp_path) -> Path:
    """The configuration of a rig in a folder of its own."""
    root = tmp_path / "rig"
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    (root / "etc/credentials/secret_mqtt").chmod(0o600)
    config = root / "etc/edge.yaml"
    config.write_text(yaml.safe_dump(settings_in(root)))
    with closing(sqlite3.connect(root / "var/history.db")) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE ticks (seq INTEGER PRIMARY KEY, utc REAL)")
        database.executemany("INSERT INTO ticks VALUES (?, ?)", ((k, 60.0 * k) for k in range(1000)))
        database.commit()
    (root / "page").mkdir()
    with closing(sqlite3.connect(root / "page/page.db")) as database:
        database.execute("CREATE TABLE links (name TEXT)")
    return config


def settings_in(root: Path) -> dict:
    return {
        "state_file": str(root / "var/state.json"),
        "history": {"path": str(root / "var/history.db")},
        "bundle": {"path": str(root / "var/bundles"), "trusted_keys": str(root / "etc/keys")},
        "drift": {"reports": str(root / "var/diagnosis")},
        "control_socket": {"path": str(root / "control.sock")},
        "page": {"folder": str(root / "page")},
    }


def contents(root: Path) -> dict[str, bytes]:
    files = (path for path in root.rglob("*") if path.is_file() and ".db" not in path.name)
    return {str(path.relative_to(root)): path.read_bytes() for path in files}


def rows(history: Path) -> list[tuple]:
    with closing(sqlite3.connect(history)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return database.execute("SELECT * FROM ticks ORDER BY seq").fetchall()


def lose(config: Path) -> None:
    """A new machine: nothing but the backup is left."""
    root = config.parent.parent
    for path in sorted(root.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()


def test_everything_comes_back(rig, tmp_path):
    root, out = rig.parent.parent, tmp_path / "backup.tar.gz"
    before, ticks = contents(root), rows(root / "var/history.db")
    back_up(rig, out)
    assert out.stat().st_mode & 0o777 == 0o600
    lose(rig)
    restored = list(restore(out, rig, replaces=False))
    assert contents(root) == before and rows(root / "var/history.db") == ticks
    assert (root / "etc/credentials/secret_mqtt").stat().st_mode & 0o777 == 0o600
    assert len(restored) == 12 and str(root / "page/page.db") in restored
    assert not [path for path in tmp_path.rglob(".*")]


def test_what_was_remembered_comes_back_with_the_history(rig, tmp_path):
    history, out = rig.parent.parent / "var/history.db", tmp_path / "backup.tar.gz"
    for path in history.parent.glob("history.db*"):
        path.unlink()
    connect(history, 1.0).close()
    book = FactBook(history, lambda: 1000.0)
    book.note("no fan at night", "Ann")
    facts = book.newest_first()
    back_up(rig, out)
    lose(rig)
    list(restore(out, rig, replaces=False))
    assert len(facts) == 1
    assert book.newest_first() == facts


def test_a_history_that_is_written_meanwhile_is_whole(rig, tmp_path):
    history, stop = rig.parent.parent / "var/history.db", threading.Event()

    def write() -> None:
        with closing(sqlite3.connect(history, timeout=10)) as database:
            seq = 1000
            while not stop.is_set():
                database.execute("INSERT INTO ticks VALUES (?, ?)", (seq, 60.0 * seq))
                database.commit()
                seq += 1

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for number in range(5):
            back_up(rig, tmp_path / f"{number}.tar.gz")
    finally:
        stop.set()
        writer.join()
    for number in range(5):
        with tarfile.open(tmp_path / f"{number}.tar.gz") as archive:
            archive.extract("history.db", tmp_path / "look", filter="data")
        found = rows(tmp_path / "look/history.db")
        assert len(found) >= 1000 and [seq for seq, _ in found] == list(range(len(found)))


def test_what_is_there_is_refused_or_kept(rig, tmp_path):
    root, out = rig.parent.parent, tmp_path / "backup.tar.gz"
    back_up(rig, out)
    (root / "var/state.json").write_text("newer")
    (root / "var/history.db-wal").write_bytes(b"of the newer history")
    before = contents(root)
    with pytest.raises(RequestError, match=r"already there: .*edge\.yaml"):
        list(restore(out, rig, replaces=False))
    assert contents(root) == before
    list(restore(out, rig, replaces=True))
    assert (root / "var/state.json").read_text() == "{}"
    [kept] = root.glob("var/state.json.before-*")
    assert kept.read_text() == "newer"
    assert len(rows(root / "var/history.db")) == 1000
    assert len(list(root.glob("var/history.db.before-*-wal"))) == 1


def test_a_running_daemon_is_not_robbed_of_its_files(rig, tmp_path):
    out = tmp_path / "backup.tar.gz"
    back_up(rig, out)
    before = contents(rig.parent.parent)
    with closing(socket.socket(socket.AF_UNIX)) as daemon:
        daemon.bind(str(rig.parent.parent / "control.sock"))
        daemon.listen()
        with pytest.raises(RequestError, match="the daemon runs"):
            list(restore(out, rig, replaces=True))
    assert contents(rig.parent.parent) == before


def changed(backup: Path, change) -> Path:
    """The backup with its members changed: change(name, bytes) -> (TarInfo, bytes) or None."""
    out = backup.with_name("changed.tar.gz")
    with tarfile.open(backup) as source, tarfile.open(out, "w:gz") as target:
        for member in source:
            data = source.extractfile(member).read()
            found = change(member, data)
            if found is not None:
                info, data = found
                info.size = len(data)
                target.addfile(info, io.BytesIO(data))
    return out


def flip(member, data):
    return (member, data[:-1] + b"x") if member.name == "state.json" else (member, data)


def drop(member, data):
    return None if member.name == "history.db" else (member, data)


def climb(member, data):
    if member.name == "state.json":
        member.name = "../state.json"
    return member, data


def link(member, data):
    if member.name == "state.json":
        member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
        return member, b""
    return member, data


def add_key(member, data):
    if member.name == MANIFEST:
        data = json.dumps(json.loads(data) | {"layuot": 2}).encode()
    return member, data


def name_a_climber(member, data):
    if member.name == MANIFEST:
        said = json.loads(data)
        said["files"]["../evil"] = "0" * 64
        data = json.dumps(said).encode()
    if member.name == "state.json":
        member.name = "../evil"
    return member, data


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (flip, "state.json is damaged"),
        (drop, "incomplete: history.db is missing"),
        (climb, "does not belong into a backup"),
        (link, "does not belong into a backup"),
        (add_key, "layuot"),
        (name_a_climber, "does not belong into a backup"),
        (lambda member, data: None if member.name == MANIFEST else (member, data), "its first member"),
    ],
    ids=["flip", "drop", "climb", "link", "unknown key", "named climber", "no manifest"],
)
def test_a_damaged_or_hostile_backup_changes_nothing(rig, tmp_path, change, said):
    back_up(rig, tmp_path / "backup.tar.gz")
    bad = changed(tmp_path / "backup.tar.gz", change)
    before = contents(tmp_path)
    with pytest.raises(DataError, match=said):
        list(restore(bad, rig, replaces=True))
    assert contents(tmp_path) == before


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_backup_that_was_cut_off_changes_nothing(rig, tmp_path, share):
    out = tmp_path / "backup.tar.gz"
    back_up(rig, out)
    out.write_bytes(out.read_bytes()[: int(out.stat().st_size * share)])
    before = contents(rig.parent.parent)
    with pytest.raises(DataError, match=r"backup\.tar\.gz"):
        list(restore(out, rig, replaces=True))
    assert contents(rig.parent.parent) == before


def test_the_command_tells_what_it_saved(rig, tmp_path, capsys):
    out = tmp_path / "backup.tar.gz"
    assert command.run(type("Arguments", (), {"config": rig, "out": out})) == 0
    said = capsys.readouterr().out
    assert "history.db" in said and "it holds secrets" in said
