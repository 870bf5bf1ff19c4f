"""edge/app/backup.py: a rig goes on elsewhere from one file; a damaged one changes nothing."""

import gzip
import io
import json
import os
import re
import socket
import sqlite3
import tarfile
import threading
from argparse import Namespace
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from edge.app import backup
from edge.app.backup import MANIFEST, _refuse_elsewhere, back_up, restore
from edge.commands import backup as command
from edge.commands import restore as restore_command
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
    for name, mode in {
        "credentials": 0o700,
        "credentials/secret_mqtt": 0o600,
        "page-credentials": 0o700,
    }.items():
        (root / "etc" / name).chmod(mode)
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
    (root / "page/page.db").chmod(0o600)
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
    """A new machine: nothing but the backup is left, and a configuration that names the same places."""
    root = config.parent.parent
    for path in sorted(root.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    config.parent.mkdir(parents=True)
    config.write_text(yaml.safe_dump(settings_in(root)))


def test_everything_comes_back(rig, tmp_path):
    root, out = rig.parent.parent, tmp_path / "backup.tar.gz"
    before, ticks = contents(root), rows(root / "var/history.db")
    back_up(rig, out)
    assert out.stat().st_mode & 0o777 == 0o600
    lose(rig)
    restored = list(restore(out, rig, replaces=True))
    [own] = root.glob("etc/edge.yaml.before-*")
    own.unlink()
    assert contents(root) == before and rows(root / "var/history.db") == ticks
    modes = {"etc/credentials": 0o700, "etc/credentials/secret_mqtt": 0o600, "page/page.db": 0o600}
    assert {name: (root / name).stat().st_mode & 0o777 for name in modes} == modes
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
    list(restore(out, rig, replaces=True))
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
        (lambda member, data: None if member.name == MANIFEST else (member, data), "is no backup of"),
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


DAMAGED, OTHER = "is damaged or cut off; nothing was changed", "is no backup of `greenhouse backup`"


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda whole: whole[:0], OTHER),
        (lambda whole: whole[:9], DAMAGED),
        (lambda whole: whole[: len(whole) * 3 // 10], DAMAGED),
        (lambda whole: whole[: len(whole) * 9 // 10], DAMAGED),
        (lambda whole: b"an email" * 100, OTHER),
        (lambda whole: gzip.compress(b"a log" * 1000), OTHER),
    ],
)
def test_a_file_that_is_damaged_or_no_backup_changes_nothing(rig, tmp_path, harm, said):
    out = tmp_path / "backup.tar.gz"
    back_up(rig, out)
    out.write_bytes(harm(out.read_bytes()))
    before = contents(rig.parent.parent)
    with pytest.raises(DataError, match=rf"^{re.escape(str(out))} {said}"):
        list(restore(out, rig, replaces=True))
    assert contents(rig.parent.parent) == before


def test_a_place_that_only_the_backup_names_is_refused(rig, tmp_path):
    out, other = tmp_path / "backup.tar.gz", tmp_path / "other"
    back_up(rig, out)
    for config in (other / "edge.yaml", Path("/etc/greenhouse/edge.yaml")):
        with pytest.raises(DataError, match=r"puts .* outside .*write a .*edge\.yaml that names this place"):
            list(restore(out, config, replaces=True))
    assert not other.exists()
    elsewhere = settings_in(rig.parent.parent) | {"state_file": str(tmp_path / "cron.d/job")}
    rig.write_text(yaml.safe_dump(elsewhere))
    with pytest.raises(DataError, match=r"puts state\.json at .*/var/state\.json"):
        list(restore(out, rig, replaces=True))


@pytest.mark.parametrize(
    ("part", "path", "is_taken"),
    [
        ("state.json", "/var/lib/greenhouse/state.json", True),
        ("state.json", "/var/lib/greenhouse/../../../etc/cron.d/job", False),
        ("state.json", "/etc/greenhouse/edge.yaml", False),
        ("state.json", "/var/lib/greenhouse", False),
        ("signing.key", "/etc/greenhouse/keys/rig.key", True),
        ("signing.key", "/etc/ssh/authorized_keys", False),
        ("page.db", "/var/lib/greenhouse-page/page.db", True),
        ("page.db", "/var/lib/greenhouse/page.db", False),
        ("history.db", "history.db", False),
    ],
)
def test_places_of_the_package_are_taken(part, path, is_taken):
    def check() -> None:
        _refuse_elsewhere(part, Path(path), None, Path("/etc/greenhouse/edge.yaml"))

    if is_taken:
        check()
    else:
        with pytest.raises(DataError, match=f"puts {part} at"):
            check()


@pytest.mark.parametrize(
    ("name", "setting"),
    [("etc/page-credentials/mail", ""), ("page/page.db", ""), ("etc/rig.pem", " (bundle.signing_key)")],
)
def test_secrets_that_others_can_read_are_refused(rig, tmp_path, name, setting):
    root = rig.parent.parent
    give_key(root)
    (root / "etc/page-credentials/mail").chmod(0o600)
    (root / name).chmod(0o644)
    (root / name).parent.chmod(0o755)
    with pytest.raises(DataError) as refused:
        back_up(rig, tmp_path / "backup.tar.gz")
    way = f"`chmod go= {root / name}`, then again"
    assert str(refused.value) == f"{root / name}{setting} can be read by other users (mode 0644): {way}"
    assert not (tmp_path / "backup.tar.gz").exists()


def give_key(root: Path) -> None:
    """Give the rig a key that signs."""
    (root / "etc/rig.pem").write_text("private")
    (root / "etc/rig.pem").chmod(0o600)
    settings = settings_in(root)
    settings["bundle"]["signing_key"] = str(root / "etc/rig.pem")
    (root / "etc/edge.yaml").write_text(yaml.safe_dump(settings))


def test_a_backup_whose_secrets_others_can_read_is_refused(rig, tmp_path):
    back_up(rig, tmp_path / "backup.tar.gz")

    def loosen(member, data):
        member.mode = 0o644
        return member, data

    bad = changed(tmp_path / "backup.tar.gz", loosen)
    with pytest.raises(DataError, match=r": page\.db can be read by .*: no backup of ours"):
        list(restore(bad, rig, replaces=True))


@pytest.mark.parametrize("name", ["etc/edge.yaml", "backup.tar.gz", "link"])
def test_a_backup_takes_the_place_of_no_file(rig, tmp_path, name):
    root = rig.parent.parent
    (root / "backup.tar.gz").write_text("of yesterday")
    (root / "link").symlink_to("nowhere")
    before = contents(root)
    with pytest.raises(RequestError, match=rf"{name} exists; choose another name"):
        back_up(rig, root / name)
    assert contents(root) == before


@pytest.mark.skipif(os.geteuid() != 0, reason="restored by root")
def test_a_restored_key_of_root_is_told(rig, tmp_path):
    give_key(rig.parent.parent)
    back_up(rig, tmp_path / "backup.tar.gz")
    told = [line for line in restore(tmp_path / "backup.tar.gz", rig, replaces=True) if "chown" in line]
    assert len(told) == 1 and "rig.pem" in told[0] and told[0].endswith("; chown it to the daemon's user")


def swell(member, data):
    return (member, bytes(20 << 20)) if member.name == "history.db" else (member, data)


def swell_a_header(member, data):
    member.pax_headers = {"comment": "x" * (2 << 20)}
    return member, data


@pytest.mark.parametrize("change", [swell, swell_a_header])
def test_a_backup_that_unpacks_to_far_more_than_its_size_is_refused(rig, tmp_path, monkeypatch, change):
    monkeypatch.setattr(backup, "TABLE", 1 << 20)
    back_up(rig, tmp_path / "backup.tar.gz")
    bad = changed(tmp_path / "backup.tar.gz", change)
    with pytest.raises(DataError, match="more than a backup of its size can"):
        list(restore(bad, rig, replaces=True))


def test_nothing_is_written_where_nobody_agrees(rig, tmp_path, capsys, monkeypatch):
    back_up(rig, tmp_path / "backup.tar.gz")
    before = contents(rig.parent.parent)
    arguments = {"file": tmp_path / "backup.tar.gz", "config": rig, "replace": True, "yes": False}
    with pytest.raises(RequestError, match="nothing was restored"):
        restore_command.run(Namespace(**arguments))
    said = capsys.readouterr()
    assert f"{rig.parent.parent}/var/state.json  2 bytes" in said.out and "--yes" in said.err
    assert contents(rig.parent.parent) == before
    assert restore_command.run(Namespace(**arguments | {"yes": True})) == 0


STRANGER = 54321  # a user's number that no account has


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be led astray")
def test_root_follows_no_link_that_the_daemons_user_has_planted(rig, tmp_path):
    """Backup reads with the rights of who owns the folder, and restore writes with them."""
    root, out = rig.parent.parent, tmp_path / "backup.tar.gz"
    for path in (tmp_path, *tmp_path.parents):
        if path != Path("/"):
            path.chmod(path.stat().st_mode | 0o011)
    for path in (root / "var", *(root / "var").rglob("*")):
        os.chown(path, STRANGER, STRANGER)
    secret = tmp_path / "secret"
    secret.write_text("of root")
    secret.chmod(0o600)
    back_up(rig, out)
    (root / "var/.state.json.restored").symlink_to(secret)
    (root / "var/.history.db.restored").symlink_to(tmp_path)
    list(restore(out, rig, replaces=True))
    assert secret.read_text() == "of root"
    assert {(root / "var" / name).stat().st_uid for name in ("state.json", "history.db", "bundles")} == {
        STRANGER
    }
    for name in ("state.json", "history.db", "bundles/roles.json"):
        whole = (root / "var" / name).read_bytes()
        (root / "var" / name).unlink()
        (root / "var" / name).symlink_to(secret)
        with pytest.raises((DataError, PermissionError)):
            back_up(rig, tmp_path / "stolen.tar.gz")
        (root / "var" / name).unlink()
        (root / "var" / name).write_bytes(whole)
        os.chown(root / "var" / name, STRANGER, STRANGER)
    assert not (tmp_path / "stolen.tar.gz").exists()
    assert os.geteuid() == 0


def test_the_command_tells_what_it_saved(rig, tmp_path, capsys):
    out = tmp_path / "backup.tar.gz"
    assert command.run(type("Arguments", (), {"config": rig, "out": out})) == 0
    said = capsys.readouterr().out
    assert "history.db" in said and "it holds secrets" in said
