"""A stop on the disk, for a daemon that does not answer."""

from pathlib import Path

import pytest

from edge.sockets.stop_file import FILE, NOBODY, StopFile


def test_a_stop_names_its_author_until_it_is_taken_away(tmp_path: Path) -> None:
    stop = StopFile(tmp_path / "stops")
    assert stop.author() is None
    stop.leave("Ann (page)")
    assert stop.author() == "Ann (page)"
    stop.leave("Bo\x1b[2J")
    assert stop.author() == "Bo [2J"
    stop.take_away()
    assert stop.author() is None
    stop.take_away()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b'{"by": ""}', b"{}", b"x" * 5000])
def test_a_stop_that_cannot_be_read_is_one(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    assert StopFile(tmp_path).author() == NOBODY


def test_a_folder_in_its_place_is_one_too(tmp_path: Path) -> None:
    (tmp_path / FILE).mkdir()
    assert StopFile(tmp_path).author() == NOBODY


def test_one_that_cannot_be_left_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "stops").write_text("a file")
    with pytest.raises(OSError, match="stops"):
        StopFile(tmp_path / "stops").leave("Ann")
