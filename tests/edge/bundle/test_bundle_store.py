"""edge/bundle/store.py, roles.py, keeper.py: what is installed, what is active, what serves."""

import json
import shutil
import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pytest
from bundles import Workshop, install, make_store

from edge.bundle.keeper import carry_out, choose
from edge.bundle.manifest import PACKAGED, Manifest
from edge.bundle.roles import Roles, activate, add_shadow, marked_good, reject_shadow, rolled_back
from edge.bundle.store import BundleStore
from edge.core.errors import DataError, RequestError
from edge.core.predictor import Predictor

# roles


def test_a_new_bundle_goes_through_shadow_and_probation_to_good() -> None:
    shadow = add_shadow(Roles(), "1")
    assert shadow == Roles(PACKAGED, None, "1")
    assert shadow.rival == "1"
    probation = activate(shadow, None)
    assert probation == Roles("1", PACKAGED, None, on_probation=True)
    assert probation.rival == PACKAGED
    good = marked_good(probation)
    assert good == Roles("1", PACKAGED)
    assert good.rival is None


def test_a_bundle_installed_during_a_probation_waits_for_its_end() -> None:
    roles = add_shadow(Roles("2", "1", None, on_probation=True), "3")
    assert roles.rival == "1"
    assert marked_good(roles).rival == "3"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (Roles("2", "1", on_probation=True), Roles("1")),
        (Roles("2", "1"), Roles("1")),
        (Roles("2", "1", "3"), Roles("1", None, "3")),
        (Roles("2"), Roles(PACKAGED)),
        (Roles(PACKAGED, "1", on_probation=True), Roles("1")),
    ],
)
def test_rolling_back_makes_the_one_before_active(before: Roles, after: Roles) -> None:
    assert rolled_back(before) == after


@pytest.mark.parametrize(
    ("before", "version", "after"),
    [
        (Roles("2", "1"), "1", Roles("1", "2", on_probation=True)),
        # The one on probation is not what is fallen back to.
        (Roles("2", "1", "3", on_probation=True), "3", Roles("3", "1", on_probation=True)),
        # Back to the one before is a roll back, and needs no proof.
        (Roles("2", "1", on_probation=True), "1", Roles("1")),
        (Roles("2"), PACKAGED, Roles(PACKAGED, "2", on_probation=True)),
        (Roles("1", None, "2"), "3", Roles("3", "1", "2", on_probation=True)),
    ],
)
def test_activating_keeps_the_last_good_one_to_fall_back_to(
    before: Roles, version: str, after: Roles
) -> None:
    assert activate(before, version) == after


def test_a_bundle_in_use_goes_on_when_it_is_installed_again() -> None:
    for roles in (Roles("1"), Roles("2", "1", on_probation=True), Roles("2", None, "1")):
        assert add_shadow(roles, "1") == roles
    assert add_shadow(Roles("2", "1"), "1").shadow == "1"  # the one before, to be tried again


@pytest.mark.parametrize(
    ("step", "roles", "words"),
    [
        (partial(activate, version=None), Roles(), "no bundle runs in shadow: say which version"),
        (partial(activate, version="1"), Roles("1"), "bundle 1 is active already"),
        (rolled_back, Roles(), "the packaged bundle is active and there is none before it"),
        (marked_good, Roles("1", "2"), "bundle 1 is not on probation"),
        (reject_shadow, Roles(), "no bundle runs in shadow"),
    ],
)
def test_a_step_that_is_none_is_refused(step, roles, words) -> None:
    with pytest.raises(RequestError, match=words):
        step(roles)


# store


def names(store: BundleStore) -> list[str]:
    return sorted(path.name for path in store.folder.iterdir())


def test_an_installed_bundle_runs_in_shadow_until_it_is_activated(workshop: Workshop) -> None:
    store = make_store(workshop)
    assert choose(store).active.manifest.version == "0"
    assert install(store, workshop.archive("1.0")) == "1.0"
    assert store.roles() == Roles(PACKAGED, None, "1.0")
    serving = choose(store)
    assert (serving.active.name, serving.rival.name, serving.on_probation) == (PACKAGED, "1.0", False)
    carry_out(store, "activate", None)
    serving = choose(store)
    assert (serving.active.name, serving.rival.name, serving.on_probation) == ("1.0", PACKAGED, True)
    assert names(store) == ["1.0", "admitted.json", "lock", "roles.json"]


def test_a_folder_installs_as_an_archive_does(workshop: Workshop) -> None:
    store = make_store(workshop)
    assert install(store, workshop.signed_folder("models", version="1.0")) == "1.0"


def test_installing_twice_changes_nothing(workshop: Workshop) -> None:
    store, bundle = make_store(workshop), workshop.archive("1.0")
    install(store, bundle)
    before = (store.folder / "1.0").stat().st_ino
    install(store, bundle)
    assert (store.folder / "1.0").stat().st_ino == before


def test_a_version_never_changes_what_it_holds(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with pytest.raises(DataError, match=r"1\.0 is installed and is another one: give it a new version"):
        install(store, workshop.signed_folder("other", version="1.0", data_sha256="e" * 64))


def test_a_damaged_installed_bundle_is_replaced_by_a_whole_one(workshop: Workshop) -> None:
    store, bundle = make_store(workshop), workshop.archive("1.0")
    install(store, bundle)
    (store.folder / "1.0" / "arx.json").write_bytes(b"")
    with pytest.raises(DataError, match=r"bundle 1\.0: arx\.json: has 0 bytes"):
        store.load("1.0")
    install(store, bundle)
    store.load("1.0")
    install(store, workshop.archive("2.0"))
    assert names(store) == ["1.0", "2.0", "admitted.json", "lock", "roles.json"]


def test_what_is_refused_leaves_nothing_behind(workshop: Workshop) -> None:
    def refuse(folder: Path, manifest: Manifest) -> Mapping[str, Predictor]:
        raise DataError("lstm.onnx: does not prove its golden vectors")

    store = make_store(workshop, load=refuse)
    with pytest.raises(DataError, match=r"lstm\.onnx: does not prove"):
        install(store, workshop.archive("1.0"))
    assert names(store) == ["lock"]
    assert store.roles() == Roles()


def test_what_an_interrupted_install_has_left_is_cleared_by_the_next(workshop: Workshop) -> None:
    store = make_store(workshop)
    (store.folder / ".incoming" / "x").mkdir(parents=True)
    (store.folder / ".damaged").mkdir()
    install(store, workshop.archive("1.0"))
    assert names(store) == ["1.0", "admitted.json", "lock", "roles.json"]
    assert store.versions() == ["1.0"]


def test_a_damaged_bundle_never_activates(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    (store.folder / "1.0" / "twin.yaml").write_text("sample_s: 61\n")
    with pytest.raises(DataError, match=r"bundle 1\.0: twin\.yaml: its sha256 is not the manifest's"):
        carry_out(store, "activate", "1.0")
    assert store.roles() == Roles(PACKAGED, None, "1.0")


@pytest.mark.parametrize("version", ["9.9", ".incoming", "../packaged", "/etc", "", "a/b"])
def test_only_what_is_installed_activates(workshop: Workshop, version: str) -> None:
    store = make_store(workshop)
    (store.folder / ".incoming").mkdir(parents=True)
    with pytest.raises(RequestError, match=r"not installed; known: packaged|is no version|no bundle runs"):
        carry_out(store, "activate", version)


def test_rolling_back_to_a_damaged_bundle_ends_at_the_packaged_one(workshop: Workshop) -> None:
    store = make_store(workshop)
    for version in ("1.0", "2.0"):
        install(store, workshop.archive(version))
        carry_out(store, "activate", None)
        carry_out(store, "mark-good", None)
    shutil.rmtree(store.folder / "1.0")
    (store.folder / "1.0").mkdir()
    assert carry_out(store, "rollback", None) == Roles(PACKAGED)


def test_changes_by_two_at_once_take_turns(workshop: Workshop) -> None:
    """Each of them activates, marks good and rolls back; nothing is ever half done."""
    store = make_store(workshop, "1.0")
    unexpected = []

    def work() -> None:
        for action in ("activate", "mark-good", "rollback") * 5:
            try:
                carry_out(store, action, "1.0")
            except RequestError:
                continue  # the other one was faster
            except Exception as error:
                unexpected.append(error)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert unexpected == []
    assert store.roles().active in ("1.0", PACKAGED)


def test_a_disk_that_refuses_is_told_in_one_line(workshop: Workshop) -> None:
    store = make_store(workshop)
    store.folder.write_text("a file")
    with pytest.raises(DataError, match="store: File exists"):
        install(store, workshop.archive("1.0"))


# what serves


def two_bundles(workshop: Workshop) -> BundleStore:
    """2.0 is active, 1.0 was before."""
    store = make_store(workshop)
    for version in ("1.0", "2.0"):
        install(store, workshop.archive(version))
        carry_out(store, "activate", None)
        carry_out(store, "mark-good", None)
    return store


def test_a_damaged_active_bundle_is_replaced_by_the_one_before(workshop: Workshop) -> None:
    store = two_bundles(workshop)
    (store.folder / "2.0" / "arx.json").unlink()
    serving = choose(store)
    assert serving.active.name == "1.0"
    assert serving.problems == ("bundle 2.0: arx.json: is missing",)
    assert store.roles().active == "2.0"


def test_where_that_is_damaged_too_the_packaged_one_serves(workshop: Workshop) -> None:
    store = two_bundles(workshop)
    shutil.rmtree(store.folder / "2.0")
    (store.folder / "1.0" / "manifest.sig").unlink()
    serving = choose(store)
    assert serving.active.name == PACKAGED
    assert [text.split(":")[0] for text in serving.problems] == [
        "bundle 2.0 is not installed; known",
        "bundle 1.0",
    ]


def test_where_nothing_is_fit_nothing_serves_and_the_reasons_are_told(workshop: Workshop) -> None:
    store = make_store(workshop)
    shutil.rmtree(workshop.folder / "packaged")
    serving = choose(store)
    assert serving.active is None
    assert "bundle packaged is not installed" in serving.problems[0]


def test_a_damaged_shadow_leaves_the_active_bundle_alone(workshop: Workshop) -> None:
    store = two_bundles(workshop)
    install(store, workshop.archive("3.0"))
    (store.folder / "3.0" / "arx.json").unlink()
    serving = choose(store)
    assert (serving.active.name, serving.rival) == ("2.0", None)
    assert serving.problems == ("bundle 3.0: arx.json: is missing",)


@pytest.mark.parametrize("text", ["", "{}", '{"active": "../x", "on_probation": false}'])
def test_a_spoilt_roles_file_means_the_packaged_bundle_until_it_is_written_anew(
    workshop: Workshop, text: str
) -> None:
    store = two_bundles(workshop)
    (store.folder / "roles.json").write_text(text)
    serving = choose(store)
    assert serving.active.name == PACKAGED
    assert "roles.json" in serving.problems[0]
    carry_out(store, "activate", "2.0")
    assert json.loads((store.folder / "roles.json").read_text())["active"] == "2.0"
    assert choose(store).problems == ()


def test_bundles_in_memory_are_not_read_again(workshop: Workshop) -> None:
    store = two_bundles(workshop)
    before = choose(store)
    shutil.rmtree(store.folder / "2.0")
    after = choose(store, {before.active.name: before.active})
    assert after.active is before.active
    assert after.problems == ()
