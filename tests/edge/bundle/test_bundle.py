"""edge/bundle: what is a good bundle, and the plain words for each that is not."""

import io
import json
import os
import shutil
import stat
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
from bundles import FACTS, Workshop, install, load_nothing

from edge.bundle import archive
from edge.bundle.archive import open_archive, pack, unpack
from edge.bundle.check import check_folder
from edge.bundle.manifest import MANIFEST, SIGNATURE
from edge.bundle.predictors import loader
from edge.bundle.sign import build_bundle, generate_key, sign_folder
from edge.bundle.store import BundleStore
from edge.core.errors import DataError
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin


def test_a_signed_folder_is_good(workshop: Workshop) -> None:
    manifest = check_folder(workshop.signed_folder("good"), workshop.trusted)
    assert manifest.version == "1.0"
    assert sorted(manifest.files) == ["arx.json", "report.json", "twin.yaml"]
    assert sorted(manifest.models) == ["arx", "pbm"]


def test_openssl_agrees_with_the_signature(workshop: Workshop) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    folder = workshop.signed_folder("good")
    command = f"openssl pkeyutl -verify -pubin -rawin -inkey {workshop.trusted / 'signing.pub'}"
    assert os.system(f"{command} -in {folder / MANIFEST} -sigfile {folder / SIGNATURE} >/dev/null 2>&1") == 0


# what is refused, and how it is told


def flip(path: Path) -> None:
    """One bit in the middle is another."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def link(folder: Path) -> None:
    (folder / "report.json").unlink()
    (folder / "report.json").symlink_to("/etc/hostname")


DAMAGE: dict[str, tuple[Callable[[Path], None], str]] = {
    "tampered model": (lambda f: flip(f / "arx.json"), "arx.json: its sha256 is not the manifest's"),
    "truncated model": (lambda f: cut(f / "arx.json"), r"arx.json: has \d+ bytes, the manifest says \d+"),
    "missing model": (lambda f: (f / "arx.json").unlink(), "arx.json: is missing"),
    "one file more": (lambda f: (f / "more.py").write_text(""), "more.py: is not in the manifest"),
    "a folder more": (lambda f: (f / "more").mkdir(), "more: is not in the manifest"),
    "a link": (link, "report.json: (is no plain file|has)"),
    "unsigned": (lambda f: (f / SIGNATURE).unlink(), "manifest.sig: is missing"),
    "empty signature": (lambda f: (f / SIGNATURE).write_bytes(b""), "the signature has 0 bytes, not 64"),
    "cut signature": (lambda f: cut(f / SIGNATURE), "the signature has 63 bytes, not 64"),
    "other signature": (lambda f: flip(f / SIGNATURE), "the signature is by none of the 2 trusted keys"),
    "tampered manifest": (lambda f: flip(f / MANIFEST), "the signature is by none of the 2 trusted keys"),
    "no manifest": (lambda f: (f / MANIFEST).unlink(), "manifest.json: is missing"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_bundle_is_refused(workshop: Workshop, damage: str) -> None:
    do, words = DAMAGE[damage]
    folder = workshop.signed_folder("bad")
    do(folder)
    with pytest.raises(DataError, match=words):
        check_folder(folder, workshop.trusted)


def signed_anew(workshop: Workshop, key: str, value: object) -> Path:
    """A bundle whose signer wrote `value` at `key`, "a.b" for b in a; None: left out."""
    from edge.bundle.sign import read_private_key

    folder = workshop.signed_folder("bad")
    document = json.loads((folder / MANIFEST).read_bytes())
    *above, last = key.split("|")
    place = document
    for name in above:
        place = place[name]
    if value is None:
        del place[last]
    else:
        place[last] = value
    content = json.dumps(document).encode()
    (folder / MANIFEST).write_bytes(content)
    (folder / SIGNATURE).write_bytes(read_private_key(workshop.key).sign(content))
    return folder


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", 2, r"manifest.json: format: 2 is not 1"),
        ("minimum_software", "0.1.1", "minimum_software: 0.1.1 is newer than 0.1.0, this one"),
        ("minimum_software", "99", "minimum_software: 99 is newer"),
        ("minimum_software", "newest", "minimum_software: 'newest' does not match"),
        ("version", "../1", "version: '../1' does not match"),
        ("version", "packaged", "version: 'packaged' is the name of the bundle that ships"),
        ("units|temp_air", "K", "units.temp_air: 'K' is not '°C'"),
        ("units|step", "min", "units.step: 'min' is not 's'"),
        ("units|heater_duty", None, "units.heater_duty: None is not '1'"),
        ("sample_s", -60, "sample_s: -60 is not above 0"),
        ("created_utc", "2026-07-01T12:00:00", "created_utc: .* is no time like"),
        ("models|arx|file", "none.json", "models.arx.file: 'none.json' is not among the files"),
        ("models|arx|kind", "onnx", "models.arx.kind: 'onnx' is not 'arx-json'"),
        ("models|oracle", {}, "models: unknown key 'oracle'; known keys: arx"),
        ("models", {}, "models: must hold at least 1"),
        ("files|twin.yaml", None, "models.pbm.file: 'twin.yaml' is not among the files"),
        ("files|../evil", {"sha256": "0" * 64, "size": 1}, r"files.../evil: '../evil' does not match"),
        ("files|manifest.sig", {"sha256": "0" * 64, "size": 1}, "is no name for a file"),
        ("files|arx.json|size", -1, "files.arx.json.size: -1 is below"),
        ("files|arx.json|sha256", "00", "files.arx.json.sha256: '00' does not match"),
        ("data_sha256", "D" * 64, "data_sha256: .* does not match"),
    ],
)
def test_a_manifest_that_is_signed_but_wrong_is_refused(
    workshop: Workshop, key: str, value: object, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        check_folder(signed_anew(workshop, key, value), workshop.trusted)


@pytest.mark.parametrize("version", ["0.1.0", "0.1", "0.0.9"])
def test_software_new_enough_is_new_enough(workshop: Workshop, version: str) -> None:
    check_folder(signed_anew(workshop, "minimum_software", version), workshop.trusted)


def test_another_persons_key_is_not_trusted(workshop: Workshop, tmp_path: Path) -> None:
    generate_key(tmp_path / "other.pem")
    folder = workshop.models("foreign")
    sign_folder(folder, FACTS, tmp_path / "other.pem")
    with pytest.raises(DataError, match="by none of the 2 trusted keys"):
        check_folder(folder, workshop.trusted)
    shutil.copy(tmp_path / "other.pub", workshop.trusted)
    check_folder(folder, workshop.trusted)


def test_a_file_that_is_no_key_is_told(workshop: Workshop) -> None:
    (workshop.trusted / "b.pub").write_text("hello")
    with pytest.raises(DataError, match=r"b\.pub: is no Ed25519 public key"):
        check_folder(workshop.signed_folder("good"), workshop.trusted)


# on its way


def test_an_archive_gives_back_what_went_in_and_is_the_same_each_time(workshop: Workshop) -> None:
    folder, into = workshop.signed_folder("good"), workshop.folder / "into"
    into.mkdir()
    packed = pack(folder)
    assert packed == pack(folder)
    unpack(io.BytesIO(packed), into)
    assert {p.name: p.read_bytes() for p in into.iterdir()} == {
        p.name: p.read_bytes() for p in folder.iterdir()
    }


def zip_of(entries: list[tuple[str, bytes]], compression: int = zipfile.ZIP_DEFLATED) -> io.BytesIO:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as file:
        for name, content in entries:
            file.writestr(name, content)
    return out


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([("../evil", b"x")], "'../evil' is no name"),
        ([("/etc/evil", b"x")], "'/etc/evil' is no name"),
        ([("a/b", b"x")], "'a/b' is no name"),
        ([(".hidden", b"x")], "'.hidden' is no name"),
        ([("..", b"x")], "'..' is no name"),
        ([("a\nb", b"x")], "is no name"),
        ([("n" * 65, b"x")], "is no name"),
        ([("twice", b"x"), ("twice", b"y")], "stands there twice"),
        ([(f"f{i}", b"") for i in range(65)], "65 files are more than a bundle may hold, 64"),
        ([("bomb", bytes((16 << 20) + 1))], "bomb: 16777217 bytes are more than a file may have"),
        ([(f"f{i}", bytes(15 << 20)) for i in range(3)], "47185920 bytes are more than a bundle may have"),
    ],
)
def test_an_archive_that_reaches_beyond_is_refused(
    tmp_path: Path, entries: list[tuple[str, bytes]], words: str
) -> None:
    with pytest.raises(DataError, match=words):
        unpack(zip_of(entries), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_longer_than_it_says_is_cut_off(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="a: holds more than its 3 bytes"):
        archive._read_bounded(io.BytesIO(b"four"), "a", 3)
    assert archive._read_bounded(io.BytesIO(b"four"), "a", 4) == b"four"


def test_an_archive_with_a_link_in_it_makes_a_plain_file(tmp_path: Path) -> None:
    out = io.BytesIO()
    info = zipfile.ZipInfo("link")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(out, "w") as file:
        file.writestr(info, "/etc/passwd")
    unpack(out, tmp_path)
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "link").read_text() == "/etc/passwd"


def test_a_truncated_archive_is_refused_wherever_it_is_cut(workshop: Workshop) -> None:
    store = BundleStore(workshop.folder / "store", workshop.trusted, load_nothing)
    whole = workshop.archive("1.0").read_bytes()
    for length in (0, 1, len(whole) // 2, len(whole) - 1):
        cut_off = workshop.folder / "cut.zip"
        cut_off.write_bytes(whole[:length])
        with pytest.raises(DataError, match="no bundle archive, or damaged"):
            install(store, cut_off)
    assert store.versions() == []


def test_a_bit_that_flips_in_an_archive_is_seen_wherever_it_is(workshop: Workshop) -> None:
    store = BundleStore(workshop.folder / "store", workshop.trusted, load_nothing)
    whole = workshop.archive("1.0").read_bytes()
    good = workshop.folder / "flipped.zip"
    for place in range(0, len(whole), 97):
        flipped = bytearray(whole)
        flipped[place] ^= 0x10
        good.write_bytes(flipped)
        with open_archive(good) as file:
            try:
                store.verify(file)
            except DataError:
                continue
        # Times, attributes and the like: nothing that is installed depends on them.
        assert {i.filename: i.CRC for i in zipfile.ZipFile(good).infolist()} == {
            i.filename: i.CRC for i in zipfile.ZipFile(io.BytesIO(whole)).infolist()
        }


def test_a_folder_with_a_link_is_no_bundle(workshop: Workshop) -> None:
    folder = workshop.signed_folder("bad")
    link(folder)
    with pytest.raises(DataError, match=r"report\.json: is no plain file"):
        open_archive(folder)


# the signing side


def test_a_private_key_is_its_owners_alone_and_never_overwritten(tmp_path: Path) -> None:
    public = generate_key(tmp_path / "key.pem")
    before = (tmp_path / "key.pem").read_bytes()
    assert stat.S_IMODE((tmp_path / "key.pem").stat().st_mode) == 0o600
    assert b"PRIVATE" not in public.read_bytes()
    with pytest.raises(DataError, match="is there already"):
        generate_key(tmp_path / "key.pem")
    public.unlink()
    with pytest.raises(DataError, match="is there already"):
        generate_key(tmp_path / "key.pem")
    assert (tmp_path / "key.pem").read_bytes() == before


@pytest.mark.parametrize("content", [None, b"", b"hello"])
def test_what_is_no_private_key_signs_nothing(workshop: Workshop, content: bytes | None) -> None:
    key = workshop.folder / "no.pem"
    if content is not None:
        key.write_bytes(content)
    with pytest.raises(DataError, match=r"no\.pem: "):
        build_bundle(workshop.models(), workshop.folder / "out.zip", FACTS, key)
    assert not (workshop.folder / "out.zip").exists()


def test_what_the_rig_would_refuse_is_not_signed(workshop: Workshop) -> None:
    folder = workshop.models()
    with pytest.raises(DataError, match="sample_s: 0 is not above 0"):
        sign_folder(folder, replace(FACTS, sample_s=0), workshop.key)
    assert not (folder / SIGNATURE).exists()


def test_no_private_key_is_in_the_repository() -> None:
    root = Path(__file__).parents[3]
    if not (root / ".git").exists():
        pytest.skip("needs the repository")
    marker = " ".join(("PRIVATE", "KEY-----"))
    found = subprocess.run(["git", "grep", "-lI", "-e", marker], cwd=root, capture_output=True, text=True)
    assert found.stdout == ""


# models


def test_the_models_of_a_bundle_predict(workshop: Workshop) -> None:
    folder = workshop.signed_folder("good")
    predictors = loader(60.0)(folder, check_folder(folder, workshop.trusted))
    assert [(p.name, p.step_s) for p in predictors.values()] == [("arx", 60.0), ("pbm", 60.0)]


def test_a_bundle_for_another_sample_time_is_refused(workshop: Workshop) -> None:
    folder = workshop.signed_folder("good")
    with pytest.raises(DataError, match=r"sample_s: made for 60 s, control\.step_s is 10"):
        loader(10.0)(folder, check_folder(folder, workshop.trusted))


def test_a_model_for_another_sample_time_than_its_bundle_is_refused(workshop: Workshop) -> None:
    folder = workshop.models("bad")
    (folder / "twin.yaml").write_text("sample_s: 30\n")
    sign_folder(folder, replace(FACTS, sample_s=30.0), workshop.key)
    with pytest.raises(DataError, match=r"arx\.json: is made for steps of 60 s, the bundle for 30 s"):
        loader(30.0)(folder, check_folder(folder, workshop.trusted))


def test_a_model_that_is_none_is_refused_though_it_is_signed(workshop: Workshop) -> None:
    folder = workshop.models("bad")
    (folder / "arx.json").write_text("{}")
    sign_folder(folder, FACTS, workshop.key)
    with pytest.raises(DataError, match=r"arx\.json: format: missing"):
        loader(60.0)(folder, check_folder(folder, workshop.trusted))


def test_a_twin_that_is_not_the_manifests_is_refused(workshop: Workshop) -> None:
    folder = signed_anew(workshop, "twin_sha256", "0" * 64)
    with pytest.raises(DataError, match=r"twin_sha256: is not that of twin\.yaml"):
        loader(60.0)(folder, check_folder(folder, workshop.trusted))


def test_the_hybrid_is_held_to_the_bundles_twin(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    """edge/models/onnx_predictor.py refuses another twin than its own; it must get that of the bundle."""
    asked = []
    stand_in = ModuleType("edge.models.onnx_predictor")
    stand_in.read_ham = lambda path, twin_sha256: asked.append((path.name, twin_sha256)) or Pbm()
    monkeypatch.setitem(sys.modules, "edge.models.onnx_predictor", stand_in)
    folder = workshop.models("hybrid")
    (folder / "ham.onnx").write_bytes(b"a graph")
    manifest = sign_folder(folder, FACTS, workshop.key)
    assert list(loader(60.0)(folder, manifest)) == ["arx", "pbm", "ham"]
    assert asked == [("ham.onnx", BoxTwin().sha256)]


def test_a_pbm_that_is_another_twin_than_the_hybrids_has_its_own_file(workshop: Workshop) -> None:
    folder = workshop.models("two-twins")
    (folder / "pbm.yaml").write_text("geometry: {volume_m3: 0.2}\n")
    manifest = sign_folder(folder, FACTS, workshop.key)
    pbm = loader(60.0)(folder, manifest)["pbm"]
    assert manifest.twin_sha256 == BoxTwin().sha256
    assert pbm.twin.geometry.volume_m3 == 0.2
