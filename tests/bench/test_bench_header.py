"""bench/header.py: timing tables say where they come from, and when they are out of date."""

import subprocess

import pytest

from bench import header
from bench.__main__ import BENCHES


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository with one measured file and one other."""
    for name in ("measured.py", "other.py"):
        (tmp_path / name).write_text("one\n")
    monkeypatch.setattr(header, "ROOT", tmp_path)
    monkeypatch.setattr(header, "MEASURED", {"a": ("measured.py",)})
    git(tmp_path, "init", "-q")
    commit(tmp_path)
    return tmp_path


def git(folder, *words):
    identity = ("-c", "user.name=t", "-c", "user.email=t@example.org")
    subprocess.run(["git", *identity, *words], cwd=folder, check=True, capture_output=True)


def commit(folder):
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "change")


def test_a_header_names_commit_machine_and_load(repository):
    text = "\n".join(header.header())
    assert "commit " in text and "cores" in text and "load average" in text
    assert "uncommitted" not in text


def test_a_header_says_that_the_code_was_not_committed(repository):
    (repository / "measured.py").write_text("two\n")
    assert "uncommitted changes" in "\n".join(header.header())


def test_a_table_is_current_while_only_other_code_changes(repository):
    table = "\n".join(header.header())
    (repository / "other.py").write_text("two\n")
    commit(repository)
    assert header.staleness("a", table).startswith("current")


def test_a_table_is_stale_once_the_measured_code_has_changed(repository):
    table = "\n".join(header.header())
    (repository / "measured.py").write_text("two\n")
    commit(repository)
    assert "the code measured has changed since" in header.staleness("a", table)


@pytest.mark.parametrize("table", ["no header at all", "commit 0123456789ab"])
def test_a_table_without_a_known_commit_is_never_current(repository, table):
    assert "current" not in header.staleness("a", table)


def test_each_measured_path_exists_and_belongs_to_a_bench():
    for name, paths in header.MEASURED.items():
        assert name in BENCHES
        assert all((header.ROOT / path).exists() for path in paths)
