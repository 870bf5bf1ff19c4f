"""Links and FIFOs planted for root's commands: python -m bench.attack.links --seed S --count N. As root only.

Whoever owns the daemon's or the page's folders plants one, and root runs a command. No file of root's may
have changed, none of what stands in it may be printed, saved or given away, and no command may hang.
"""

import os
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from random import Random

import yaml

from bench.attack.part import TrialResult, main_of
from edge.app.backup import back_up
from edge.page.access import Access, Role
from edge.storage.file import connect
from tests.support.daemon_process import ROOT

USER = 54321  # who owns the folders; no account
SECRET = "what only root may read"
WITHIN_S = 60.0
CONFIG = "etc/edge.yaml"
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("page", "pair"),
    ("page", "link", "--name", "Eve"),
    ("page", "person", "Eve"),
    ("page", "sessions"),
    ("page", "revoke"),
    ("backup", "--out", "{root}/backup.tar.gz"),
    ("restore", "{root}/good.tar.gz", "--replace", "--yes"),
    ("bundle", "list"),
    ("bundle", "rollback"),
    ("bundle", "activate", "1.0"),
    ("evidence", "extend"),
    ("check-config", "{root}/etc/edge.yaml"),
)
PLACES = (
    *("page/page.db", "page/page.db-journal", "page", "var/state.json", "var/.state.json.restored"),
    *("var/history.db", "var/history.db-wal", "var/history.db-numbers", "var/.history.db.restored"),
    *("var/bundles", "var/bundles/roles.json", "var/bundles/lock", "var/bundles/.incoming"),
    *("var/bundles/1.0", "var/evidence", "var/evidence/.lock", "var/diagnosis", "var"),
)
KINDS = ("file", "database", "folder", "fifo")  # what is planted leads to


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """`count` commands, each with something planted at a place."""
    if os.geteuid():
        raise SystemExit("only root can be led astray")
    draw = Random(seed)
    for number in range(count):
        command, place, kind = draw.choice(COMMANDS), draw.choice(PLACES), draw.choice(KINDS)
        with tempfile.TemporaryDirectory(prefix="gh-links-") as name:
            root = Path(name)
            root.chmod(0o755)
            _build(root)
            _plant(root, root / place, kind)
            before = _of_root(root)
            said = _call(root, command)
            found = list(_violations(root, before, said))
        yield TrialResult(f"{number}: {' '.join(command)}, {kind} at {place}", 1, found)


def _build(root: Path) -> None:
    """Make a rig's folders with a good backup of it, and the folder of root's secrets."""
    for folder in ("etc", "var/bundles/1.0", "var/evidence", "var/diagnosis", "page", "roots/folder"):
        (root / folder).mkdir(parents=True)
    settings = {
        "state_file": str(root / "var/state.json"),
        "history": {"path": str(root / "var/history.db")},
        "bundle": {"path": str(root / "var/bundles"), "trusted_keys": str(root / "etc/keys")},
        "drift": {"reports": str(root / "var/diagnosis")},
        "control_socket": {"path": str(root / "control.sock")},
        "page": {"folder": str(root / "page")},
    }
    (root / CONFIG).write_text(yaml.safe_dump(settings))
    (root / "var/state.json").write_text("{}")
    connect(root / "var/history.db", 1.0).close()
    Access.of(root / "page").make_link(Role.VIEW, "class", 1e6, None)
    (root / "var/bundles/roles.json").write_text('{"active": "packaged"}')
    back_up(root / CONFIG, root / "good.tar.gz")
    for place in (root / "roots/file", root / "roots/folder/file"):
        place.write_text(SECRET)
    with closing(sqlite3.connect(root / "roots/database")) as database:
        database.execute("CREATE TABLE links (id, secret, name)")
        database.execute("INSERT INTO links VALUES (1, ?, ?)", (SECRET, SECRET))
        database.commit()
    for place in (root / "roots").rglob("*"):
        place.chmod(0o700 if place.is_dir() else 0o600)
    for folder in ("var", "page"):
        for place in (root / folder, *(root / folder).rglob("*")):
            os.chown(place, USER, USER)


def _plant(root: Path, place: Path, kind: str) -> None:
    if place.is_dir() and kind == "fifo":
        kind = "folder"
    if place.is_dir():
        shutil.rmtree(place)
    place.unlink(missing_ok=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    if kind == "fifo":
        os.mkfifo(place)
    else:
        place.symlink_to(root / "roots" / kind)
    os.lchown(place, USER, USER)


def _of_root(root: Path) -> dict[str, tuple[int, int, int, bytes]]:
    """Return owner, mode and content of all that is root's and secret."""
    found = {}
    for place in (root / "roots", *(root / "roots").rglob("*")):
        status = place.lstat()
        content = place.read_bytes() if place.is_file() else b""
        found[str(place.relative_to(root))] = (status.st_uid, status.st_gid, status.st_mode, content)
    return found


def _call(root: Path, command: tuple[str, ...]) -> str:
    words = [word.format(root=root) for word in command]
    options = [] if words[0] == "check-config" else ["--config", str(root / CONFIG)]
    words = [*words, *options] if words[0] == "evidence" else [words[0], *options, *words[1:]]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "edge", *words],
            cwd=ROOT, input="a long password\n", capture_output=True, text=True, timeout=WITHIN_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"hangs for {WITHIN_S:g} s"
    return done.stdout + done.stderr


def _violations(root: Path, before: dict[str, tuple[int, int, int, bytes]], said: str) -> Iterator[str]:
    after = _of_root(root)
    yield from (
        f"{name} changed" for name in before.keys() | after.keys() if before.get(name) != after.get(name)
    )
    if "hangs" in said or "Traceback" in said:
        yield said[-300:]
    if SECRET in said:
        yield "the secret was printed"
    for folder in ("var", "page", "etc"):
        for place in (root / folder).rglob("*"):
            is_own = (root / "roots") not in place.resolve().parents
            if is_own and place.is_file() and SECRET.encode() in place.read_bytes():
                yield f"{place.relative_to(root)} holds the secret"
    with suppress(FileNotFoundError), tarfile.open(root / "backup.tar.gz") as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is not None and SECRET.encode() in content.read():
                yield f"{member.name} of the backup holds the secret"


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 200, "links", __doc__))
