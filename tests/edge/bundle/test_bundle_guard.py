"""Hostile signed bundles: older ones, graphs that never end, files exchanged between check and load."""

import shutil
import time
from pathlib import Path

import pytest
from bundles import Workshop, install, load_nothing, make_store

from bench.attack.bundles import ENDLESS, GREEDY, KINDS, run
from edge.__main__ import main
from edge.bundle.archive import open_archive
from edge.bundle.check import read_checked
from edge.bundle.keeper import BundleKeeper, carry_out
from edge.bundle.manifest import PACKAGED
from edge.bundle.predictors import loader
from edge.bundle.proof import ProofLimits, Prover
from edge.bundle.sign import ManifestFacts, build_bundle
from edge.bundle.store import PACKAGED_FOLDER, BundleStore, release
from edge.core.clock import RealClock
from edge.core.errors import DataError
from tests.support.broker import wait_for

pytestmark = pytest.mark.slow


def prover(workshop: Workshop, **limits: float) -> Prover:
    return Prover(workshop.trusted, 60.0, ProofLimits(**limits))


def with_graph(workshop: Workshop, graph: bytes, version: str = "1.0") -> Path:
    """An archive with a policy of this graph."""
    models = workshop.models(f"evil-{version}")
    (models / "rl-off.onnx").write_bytes(graph)
    out = workshop.folder / f"evil-{version}.zip"
    build_bundle(models, out, ManifestFacts(version, "2026-07-01T12:00:00Z", "d" * 64), workshop.key)
    return out


# older versions


@pytest.mark.parametrize(
    ("version", "numbers"),
    [("2.0", (2,)), ("1.10", (1, 10)), ("2.0-twin-3f2a", (2,)), ("alpha", ()), ("0", ())],
)
def test_versions_compare_by_the_numbers_that_they_begin_with(version: str, numbers: tuple[int, ...]) -> None:
    assert release(version) == numbers


@pytest.mark.parametrize("version", ["0.1", "1.9.9", "alpha"])
def test_an_older_bundle_is_refused_however_it_is_signed(workshop: Workshop, version: str) -> None:
    store = make_store(workshop, "2.0")
    with pytest.raises(DataError, match=rf"bundle {version} is older than 2\.0.*--allow-older"):
        install(store, workshop.archive(version))
    assert store.versions() == ["2.0"]
    assert store.roles().shadow == "2.0"


def test_removing_the_newest_or_rolling_back_lowers_nothing(workshop: Workshop) -> None:
    store = make_store(workshop)
    for version in ("1.0", "2.0"):
        install(store, workshop.archive(version))
        carry_out(store, "activate", None)
    store.roll_back()
    shutil.rmtree(store.folder / "2.0")
    with pytest.raises(DataError, match=r"1\.5 is older than 2\.0"):
        install(store, workshop.archive("1.5"))


def test_the_operators_flag_takes_an_older_one_in_and_begins_to_count_there(workshop: Workshop) -> None:
    store = make_store(workshop, "2.0")
    with open_archive(workshop.archive("1.0")) as archive:
        store.install(archive, allow_older=True)
    install(store, workshop.archive("1.1"))
    with pytest.raises(DataError, match=r"0\.9 is older than 1\.1"):
        install(store, workshop.archive("0.9"))


def test_a_bundle_with_another_twin_is_as_old_as_the_active_one(workshop: Workshop) -> None:
    store = make_store(workshop)
    for version in ("1.0", "2.0"):
        install(store, workshop.archive(version))
        carry_out(store, "activate", version)
    store.roll_back()
    assert store.roles().active == PACKAGED  # 1.0 had not proved itself
    carry_out(store, "activate", "1.0")
    install(store, workshop.archive("1.0-twin-00000000"))
    with pytest.raises(DataError, match="older"):
        install(store, workshop.archive("1.1"))


@pytest.mark.parametrize("text", ["", "[]", '{"newest": 5, "proved": []}', "[" * 100_000])
def test_without_its_record_a_store_asks_the_operator(workshop: Workshop, text: str) -> None:
    store = make_store(workshop, "2.0")
    (store.folder / "admitted.json").write_text(text)
    with pytest.raises(DataError, match=r"admitted\.json: .*--allow-older"):
        install(store, workshop.archive("2.1"))
    (store.folder / "admitted.json").unlink()  # a store of earlier software has none
    with pytest.raises(DataError, match="older than 2"):
        install(store, workshop.archive("1.0"))


def test_the_command_has_the_flag_and_the_daemon_tells_of_it(workshop: Workshop, capsys, monkeypatch) -> None:
    packaged = workshop.signed_folder("packaged", version="0")
    monkeypatch.setattr(BundleStore.__init__, "__defaults__", (packaged, None))
    monkeypatch.setattr("edge.commands.bundle.Prover", lambda *_: None)
    config = workshop.folder / "edge.yaml"
    folder = workshop.folder / "store"
    config.write_text(
        f"bundle: {{path: {folder}, trusted_keys: {workshop.trusted}}}\n"
        f"control_socket: {{path: {workshop.folder / 'none.sock'}}}\n"
    )
    for words, code in (([workshop.archive("2.0")], 0), ([workshop.archive("1.0")], 2)):
        assert main(["bundle", "--config", str(config), "install", *map(str, words)]) == code
    older = str(workshop.folder / "1.0.zip")
    assert main(["bundle", "--config", str(config), "install", "--allow-older", older]) == 0
    assert "older versions were allowed" in capsys.readouterr().out
    keeper = BundleKeeper(make_store(workshop), RealClock(), automatic=False, trial_ticks=10)
    keeper.answer({"action": "refresh-older", "version": "1.0"})
    told: list[str] = []
    wait_for(lambda: told.extend(f"{e.key} {e.text}" for e in keeper.events_pending()) or told)
    keeper.close()
    assert told[0].startswith("bundle.refresh-older --allow-older took in '1.0'; ")


# models that do not end


@pytest.mark.parametrize(("graph", "memory"), [(ENDLESS, 300 << 20), (GREEDY, 300 << 20)])
def test_a_graph_without_end_or_measure_is_refused_in_its_own_process(
    workshop: Workshop, graph: bytes, memory: int
) -> None:
    store = make_store(workshop, load=loader(60.0), prove=prover(workshop, cpu_s=3, memory=memory))
    begin_s = time.monotonic()
    with pytest.raises(DataError, match=r"models end the process|cannot be run"):
        install(store, with_graph(workshop, graph))
    assert time.monotonic() - begin_s < 60.0
    assert store.versions() == []
    install(store, workshop.archive("1.0"))


def test_a_process_that_only_waits_is_ended_by_the_clock(workshop: Workshop) -> None:
    store = make_store(workshop, load=loader(60.0), prove=prover(workshop, cpu_s=60, wall_s=2.0))
    with pytest.raises(DataError, match="not proved after 2 s"):
        install(store, with_graph(workshop, ENDLESS))


def test_a_bundle_put_into_the_store_by_hand_is_proved_before_it_is_loaded(workshop: Workshop) -> None:
    trusting = make_store(workshop, "1.0")
    folder = workshop.folder / "store" / "1.1"
    shutil.copytree(workshop.signed_folder("by-hand", version="1.1"), folder)
    asked: list[str] = []
    store = BundleStore(
        trusting.folder, workshop.trusted, load_nothing, prove=lambda place: asked.append(place.name)
    )
    store.load("1.0")
    assert asked == []
    store.load("1.1")
    assert asked == ["1.1"]
    (folder.parent / "admitted.json").write_text("{")  # nothing says any more who has proved its models
    store.load("1.0")
    assert asked == ["1.1", "1.0"]


def test_a_sound_bundle_is_proved_and_a_wrong_one_refused_with_its_reason(workshop: Workshop) -> None:
    store = make_store(workshop, load=loader(60.0), prove=prover(workshop))
    install(store, with_graph(workshop, (PACKAGED_FOLDER / "rl-off.onnx").read_bytes(), "1.0"))
    assert store.versions() == ["1.0"]
    with pytest.raises(DataError, match=r"rl-off\.onnx: not an ONNX file"):
        install(store, with_graph(workshop, b"x", "1.1"))


# what was checked is what is loaded


def test_a_file_exchanged_between_check_and_load_is_not_loaded(workshop: Workshop, monkeypatch) -> None:
    make_store(workshop, "1.0")
    place = workshop.folder / "store" / "1.0"

    def exchange(folder: Path, keys: Path) -> object:
        checked = read_checked(folder, keys)
        for path in place.iterdir():
            path.write_bytes(b"evil")
        return checked

    monkeypatch.setattr("edge.bundle.store.read_checked", exchange)
    rig = BundleStore(workshop.folder / "store", workshop.trusted, loader(60.0), workshop.folder / "packaged")
    loaded = rig.load("1.0")
    assert (place / "arx.json").read_bytes() == b"evil"
    assert loaded.predictors["arx"].step_s == 60.0


# all of it, in short; the long form is `python -m bench.attack bundles`


def test_hostile_bundles_are_refused_and_the_active_one_goes_on() -> None:
    found = list(run(1000, 12))
    assert len(found) == 12
    assert [(each.name, each.violations) for each in found if each.violations] == []
    assert len(KINDS) > 30
