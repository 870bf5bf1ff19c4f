"""edge/evidence/proof.py: any change of a sealed record is refused, and the message names the place."""

import gzip
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from sealed_records import NOON_UTC, RecordRig

from edge.bundle.sign import generate_key, read_private_key
from edge.core.errors import DataError
from edge.evidence import day_rows
from edge.evidence.chain import seal_chain
from edge.evidence.chain_files import DAY_S, RECORD, sha256
from edge.evidence.proof import open_record

Files = dict[str, bytes]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> RecordRig:
    """A record of four days with one gap."""
    rig = RecordRig(tmp_path_factory.mktemp("record") / "rig").live(3.5)
    rig.forget(60, 62, "the disk was full")
    rig.seal(4.0)
    return rig


@pytest.fixture(scope="module")
def archive(sealed: RecordRig) -> Path:
    return sealed.folder / "record.zip"


def files_of(archive: Path) -> Files:
    with zipfile.ZipFile(archive) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def packed(files: Files, out: Path) -> Path:
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in files.items():
            target.writestr(name, content)
    return out


def packed_lines(lines: bytes) -> bytes:
    return gzip.compress(lines, mtime=0)


def swap(files: Files, one: str, other: str) -> None:
    files[one], files[other] = files[other], files[one]


def edit(files: Files, name: str, **values: object) -> None:
    files[name] = json.dumps({**json.loads(files[name]), **values}).encode()


def sign_anew(files: Files, name: str, key: Path) -> None:
    files[name.replace(".json", ".sig")] = read_private_key(key).sign(files[name])


def test_a_sealed_record_holds_and_says_what_it_holds(archive: Path, sealed: RecordRig) -> None:
    record = open_record(archive, sealed.key.with_suffix(".pub"))
    assert [day.date for day in record.days] == [f"2026-01-0{n}" for n in (1, 2, 3, 4)]
    assert record.missing == 3
    assert [gap.reason for gap in record.days[1].gaps] == ["the disk was full"]
    assert len(record.heads) == 5
    open_record(archive, heads=[record.heads[0].upper(), record.heads[2]])


def change_a_row(files: Files) -> None:
    name = "day-0002.jsonl.gz"
    files[name] = gzip.compress(gzip.decompress(files[name]).replace(b'"value":25.0', b'"value":24.0', 1))


def drop_a_day(files: Files) -> None:
    for name in [name for name in files if name.startswith("day-0002")]:
        del files[name]


def swap_days(files: Files) -> None:
    for ending in (".json", ".sig", ".jsonl.gz"):
        swap(files, f"day-0002{ending}", f"day-0003{ending}")


def cut_the_end(files: Files) -> None:
    for name in [name for name in files if name.startswith("day-0004")]:
        del files[name]


def swap_rows(files: Files) -> None:
    swap(files, "day-0002.jsonl.gz", "day-0003.jsonl.gz")


def swap_signatures(files: Files) -> None:
    swap(files, "day-0002.sig", "day-0003.sig")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (change_a_row, r"day-0002\.jsonl\.gz: changed after it was sealed"),
        (drop_a_day, r"day-0002\.json is missing: seal\.json counts 4 days"),
        (cut_the_end, r"day-0004\.json is missing: seal\.json counts 4 days"),
        (swap_days, r"day-0002\.json: is of day 3, 2026-01-03, and stands for 2"),
        (swap_rows, r"day-0002\.jsonl\.gz: changed after it was sealed"),
        (swap_signatures, r"day-0002\.sig: the signature is by none"),
        (lambda files: edit(files, "day-0003.json", ticks=1), r"day-0003\.sig: the signature is by none"),
        (lambda files: edit(files, "seal.json", days=3), r"seal\.sig: the signature is by none"),
        (lambda files: edit(files, "start.json", after_seq=0), r"start\.sig: the signature is by none"),
        (lambda files: files.update({"day-0002.sig": b"short"}), r"day-0002\.sig: the signature has 5 bytes"),
        (lambda files: files.pop("seal.json"), r"seal\.json is missing"),
        (lambda files: files.pop("signer.pub"), r"signer\.pub is missing"),
        (lambda files: files.update({"day-0005.json": b"{}"}), r"day-0005\.json does not belong"),
        (lambda files: files.update({"note.txt": b"hello"}), r"note\.txt does not belong"),
        (lambda files: files.update({"../evil": b"x"}), r"'\.\./evil' is no name for a file"),
        (lambda files: files.update({"/etc/passwd": b"x"}), r"'/etc/passwd' is no name for a file"),
        (lambda files: files.update({"a/b": b"x"}), r"'a/b' is no name for a file"),
        (lambda files: files.update({".hidden": b"x"}), r"'\.hidden' is no name for a file"),
        (lambda files: files.update({"signer.pub": b"x" * (2 << 20)}), r"signer\.pub: larger than"),
    ],
)
def test_a_change_is_refused_and_its_place_named(
    archive: Path, tmp_path: Path, change: Callable[[Files], object], why: str
) -> None:
    files = files_of(archive)
    change(files)
    bad = packed(files, tmp_path / "bad.zip")
    with pytest.raises(DataError, match=why) as refused:
        open_record(bad)
    assert str(refused.value).startswith(str(bad))


def hide_a_gap(files: Files) -> None:
    edit(files, "day-0002.json", gaps=[])


def leave_out_a_tick(files: Files) -> None:
    """Rows and digest changed together, as one with the key could; the gap is not listed."""
    lines = gzip.decompress(files["day-0002.jsonl.gz"]).splitlines(keepends=True)
    rows = gzip.compress(b"".join(lines[:-1]))
    files["day-0002.jsonl.gz"] = rows
    edit(files, "day-0002.json", rows_sha256=sha256(rows), ticks=44)


def repeat_a_tick(files: Files) -> None:
    lines = gzip.decompress(files["day-0002.jsonl.gz"]).splitlines(keepends=True)
    rows = gzip.compress(b"".join([*lines, lines[-1]]))
    files["day-0002.jsonl.gz"] = rows
    edit(files, "day-0002.json", rows_sha256=sha256(rows))


@pytest.mark.parametrize(
    ("change", "name", "why"),
    [
        (hide_a_gap, "day-0002.json", r"day-0002\.jsonl\.gz: tick numbers are missing that its entry"),
        (leave_out_a_tick, "day-0002.json", r"day-0002\.jsonl\.gz: tick numbers are missing that its entry"),
        (repeat_a_tick, "day-0002.json", r"day-0002\.jsonl\.gz: tick \d+ is out of order"),
        (
            lambda files: edit(files, "day-0002.json", previous_sha256="0" * 64),
            "day-0002.json",
            r"day-0002\.json: names another entry before it",
        ),
        (
            lambda files: edit(files, "day-0002.json", sealed_utc=NOON_UTC),
            "day-0002.json",
            r"day-0002\.json: was sealed before its day was over",
        ),
        (
            lambda files: edit(files, "day-0002.json", after_seq=3),
            "day-0002.json",
            r"day-0002\.json: begins after tick 3, and tick 25 was sealed last",
        ),
        (
            lambda files: edit(files, "day-0002.json", marks=1),
            "day-0002.json",
            r"day-0002\.jsonl\.gz: holds 45 ticks and 0 marks",
        ),
        (
            lambda files: edit(files, "day-0001.json", ticks=24.5),
            "day-0001.json",
            r"day-0001\.json: ticks: must be a whole number",
        ),
        (
            lambda files: edit(files, "seal.json", head_sha256="0" * 64),
            "seal.json",
            r"seal\.json: names another last entry than day-0004\.json",
        ),
        (
            lambda files: edit(files, "start.json", key_sha256="0" * 64),
            "start.json",
            r"start\.json: names the key 0000",
        ),
    ],
)
def test_one_with_the_key_cannot_seal_what_contradicts_itself(
    archive: Path, sealed: RecordRig, tmp_path: Path, change: Callable[[Files], object], name: str, why: str
) -> None:
    files = files_of(archive)
    change(files)
    sign_anew(files, name, sealed.key)
    with pytest.raises(DataError, match=why):
        open_record(packed(files, tmp_path / "bad.zip"))


def test_another_key_is_refused_where_the_signer_is_known(archive: Path, tmp_path: Path) -> None:
    other = generate_key(tmp_path / "other.pem")
    with pytest.raises(DataError, match=r"signer\.pub: the record is signed by another key than"):
        open_record(archive, other)
    files = files_of(archive)
    files["signer.pub"] = other.read_bytes()
    with pytest.raises(DataError, match=r"start\.sig: the signature is by none"):
        open_record(packed(files, tmp_path / "bad.zip"))


def test_a_record_sealed_again_from_the_start_does_not_hold_the_published_head(
    sealed: RecordRig, tmp_path: Path
) -> None:
    """The owner of the key cuts a day off and seals anew: it holds by itself, and the head tells."""
    head = open_record(sealed.folder / "record.zip").heads[-1]
    chain = shutil.copytree(sealed.chain, tmp_path / "evidence")
    for path in chain.glob("day-0004*"):
        path.unlink()
    shorter = tmp_path / "shorter.zip"
    seal_chain(chain, sealed.key, shorter, NOON_UTC + 5 * DAY_S)
    assert len(open_record(shorter).days) == 3
    with pytest.raises(DataError, match=f"the published head {head} is not in this chain"):
        open_record(shorter, heads=[head])


# hostile archives


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.zip").write_bytes(b"")
    (tmp_path / "text.zip").write_text("hello")
    for name, why in (
        ("empty.zip", "no record archive, or damaged"),
        ("text.zip", "no record archive, or damaged"),
        ("missing.zip", "No such file"),
        ("", "not a regular file"),
    ):
        with pytest.raises(DataError, match=f"{tmp_path / name}: {why}"):
            open_record(tmp_path / name)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
def test_an_archive_that_was_cut_off_is_refused(archive: Path, tmp_path: Path, share: float) -> None:
    content = archive.read_bytes()
    (tmp_path / "cut.zip").write_bytes(content[: int(len(content) * share)])
    with pytest.raises(DataError, match="no record archive, or damaged"):
        open_record(tmp_path / "cut.zip")


def test_more_files_than_a_record_may_hold_are_refused_before_one_is_written(tmp_path: Path) -> None:
    bad = packed({f"f{number}": b"" for number in range(RECORD.files + 1)}, tmp_path / "many.zip")
    with pytest.raises(DataError, match="files are more than a record may hold"):
        open_record(bad)


def test_a_file_that_unpacks_beyond_its_limit_is_refused_by_its_size(tmp_path: Path) -> None:
    out = tmp_path / "bomb.zip"
    with (
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target,
        target.open("day-0001.json", "w") as file,
    ):
        for _ in range((RECORD.file_bytes >> 20) + 1):
            file.write(b"\0" * (1 << 20))
    with pytest.raises(DataError, match=r"day-0001\.json: \d+ bytes are more than a file may have"):
        open_record(out)


def test_a_name_that_stands_twice_is_refused(archive: Path, tmp_path: Path) -> None:
    out = tmp_path / "twice.zip"
    shutil.copy(archive, out)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(out, "a") as target:
        target.writestr("start.json", b"{}")
    with pytest.raises(DataError, match="a file name stands there twice"):
        open_record(out)


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (b"not gzip", "not a packed day, or damaged"),
        (packed_lines(b"{}\n")[:-6], "not a packed day, or damaged"),
        (packed_lines(b"[" * 100_000 + b"\n"), "line 1: not JSON: nested too deep"),
        (packed_lines(b'{"tick": {"seq": 1}}\n'), r"line 1: tick\.utc: missing"),
        (packed_lines(b'{"tock": 1}\n'), "line 1: unknown key 'tock'; did you mean 'tick'"),
        (packed_lines(b"{}\n{"), "line 2: longer than a line, or a day"),
        (packed_lines(b" " * (2 << 20)), "line 1: longer than a line, or a day"),
    ],
    ids=["text", "cut off", "too deep", "no time", "unknown key", "half a line", "long line"],
)
def test_rows_that_are_not_rows_are_refused_by_their_line(rows: bytes, why: str) -> None:
    with pytest.raises(DataError, match=why):
        list(day_rows.read_rows(rows, "day"))


def test_a_packed_day_that_never_ends_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(day_rows, "ROWS_BYTES_MAX", 10_000)
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb") as file:
        file.write(b"{}\n" * 4000)
    with pytest.raises(DataError, match="line 3334: longer than a line, or a day, may be"):
        list(day_rows.read_rows(out.getvalue(), "day"))
