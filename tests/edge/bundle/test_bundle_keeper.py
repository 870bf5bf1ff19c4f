"""edge/bundle/keeper.py: bundles are exchanged while the control thread goes on."""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bundles import Workshop, install, make_store

from edge.bundle.keeper import JOBS_WAITING, BundleKeeper
from edge.bundle.manifest import PACKAGED, Manifest
from edge.bundle.roles import Roles
from edge.bundle.store import BundleStore
from edge.bundle.trial import HorizonScore
from edge.core.clock import RealClock
from edge.core.messages import Severity
from edge.core.predictor import Predictor

TICKS = 10


@contextmanager
def keeping(store: BundleStore, automatic: bool = False) -> Iterator[BundleKeeper]:
    keeper = BundleKeeper(store, RealClock(), automatic, TICKS)
    try:
        yield keeper
    finally:
        keeper.close()


def done(keeper: BundleKeeper, reply: Mapping[str, Any]) -> dict[str, Any]:
    """The state after the job of `reply`."""
    assert reply["ok"], reply
    for _ in range(1000):
        status = keeper.answer({"action": "status", "job": reply["job"]})
        if status["job_done"]:
            return status
        time.sleep(0.005)
    raise AssertionError("the job is not done")


def rows(active_k: float, rival_k: float, count: int = TICKS) -> list[HorizonScore]:
    return [HorizonScore("arx", 60.0, count, active_k, rival_k)]


def settled(keeper: BundleKeeper) -> None:
    """All jobs that were posted are done."""
    done(keeper, keeper.answer({"action": "refresh"}))


def test_an_activation_exchanges_what_serves_and_is_told(workshop: Workshop) -> None:
    store = make_store(workshop)
    with keeping(store) as keeper:
        assert keeper.serving.active.name == PACKAGED
        install(store, workshop.archive("1.0"))
        assert done(keeper, keeper.answer({"action": "refresh"}))["rival"] == "1.0"
        packaged = keeper.serving.active
        status = done(keeper, keeper.answer({"action": "activate", "version": None}))
        assert (status["active"], status["rival"], status["on_probation"]) == ("1.0", PACKAGED, True)
        assert keeper.serving.rival is packaged  # what was in memory goes on
        told = keeper.events_pending()
        assert [event.key for event in told] == ["bundle.refresh", "bundle.activate"]
        assert told[1].text == "asked for; 1.0 is active, on probation; packaged runs beside it"
        assert keeper.events_pending() == []
    assert store.roles() == Roles("1.0", PACKAGED, on_probation=True)


def test_the_control_thread_never_waits_for_models_that_load(workshop: Workshop) -> None:
    loading, go_on = threading.Event(), threading.Event()
    go_on.set()

    def slow(folder: Path, manifest: Manifest) -> dict[str, Predictor]:
        loading.set()
        assert go_on.wait(20)
        return {}

    store = make_store(workshop, "1.0", load=slow)
    with keeping(store) as keeper:
        go_on.clear()
        loading.clear()
        reply = keeper.answer({"action": "activate", "version": None})
        assert loading.wait(20)
        # The model is still loading; ticks see the old bundle, scores and requests are taken.
        assert keeper.serving.active.name == PACKAGED
        keeper.consider(keeper.serving, rows(0.3, 0.3))
        status = keeper.answer({"action": "status", "job": reply["job"]})
        assert (status["active"], status["job_done"]) == (PACKAGED, False)
        waiting = [keeper.answer({"action": "refresh"}) for _ in range(JOBS_WAITING)]
        assert waiting[-1] == {"ok": False, "error": "too many requests wait"}
        go_on.set()
        assert done(keeper, reply)["active"] == "1.0"


def test_an_order_that_fails_is_told_and_changes_nothing(workshop: Workshop) -> None:
    with keeping(make_store(workshop)) as keeper:
        refused = keeper.answer({"action": "fly"})
        assert not refused["ok"] and "action: 'fly' is none of status, list, activate" in refused["error"]
        before = keeper.serving
        status = done(keeper, keeper.answer({"action": "activate", "version": "9"}))
        assert status["job_error"] == "bundle 9 is not installed; known: packaged"
        assert keeper.serving is before
        told = keeper.events_pending()
    assert [(event.key, event.severity) for event in told] == [("bundle.failed", Severity.WARNING)]


def test_a_bug_in_a_job_does_not_end_the_thread(workshop: Workshop) -> None:
    broken = False

    def load(folder: Path, manifest: Manifest) -> dict[str, Predictor]:
        return {"arx": 1 / 0} if broken else {}

    store = make_store(workshop, "1.0", load=load)
    with keeping(store) as keeper:
        broken = True
        assert "ZeroDivisionError" in done(keeper, keeper.answer({"action": "activate"}))["job_error"]
        broken = False
        assert done(keeper, keeper.answer({"action": "activate"}))["active"] == "1.0"


def test_a_bundle_that_cannot_serve_is_a_fault_while_that_is_so(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    (store.folder / "1.0" / "arx.json").unlink()
    with keeping(store) as keeper:
        assert keeper.faults() == {"bundle.refused": "bundle 1.0: arx.json: is missing"}
        done(keeper, keeper.answer({"action": "reject"}))
        assert keeper.faults() == {}


# by the scores


def test_a_better_shadow_is_activated_and_marked_good(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store, automatic=True) as keeper:
        keeper.consider(keeper.serving, rows(0.3, 0.2, TICKS - 1))
        settled(keeper)
        assert keeper.serving.active.name == PACKAGED
        keeper.consider(keeper.serving, rows(0.3, 0.2))
        settled(keeper)
        assert store.roles() == Roles("1.0", PACKAGED, on_probation=True)
        keeper.consider(keeper.serving, rows(0.2, 0.3))
        settled(keeper)
        assert store.roles() == Roles("1.0", PACKAGED)
        told = [event.text for event in keeper.events_pending() if event.key == "bundle.activate"]
    assert told[0].startswith("errors of 1.0 are 0.667 times those of packaged")


def test_a_bundle_that_turns_out_worse_is_rolled_back_and_not_tried_again(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store, automatic=True) as keeper:
        done(keeper, keeper.answer({"action": "activate"}))
        keeper.consider(keeper.serving, rows(0.4, 0.3))
        settled(keeper)
        assert store.roles() == Roles(PACKAGED)
        assert keeper.serving.rival is None


def test_a_worse_shadow_runs_no_more(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store, automatic=True) as keeper:
        keeper.consider(keeper.serving, rows(0.3, 0.4))
        settled(keeper)
        assert store.roles() == Roles(PACKAGED)


def test_without_automatic_the_judgement_is_shown_and_nothing_done(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store) as keeper:
        keeper.consider(keeper.serving, rows(0.3, 0.2))
        settled(keeper)
        assert keeper.answer({"action": "status"})["judgement"]["verdict"] == "promote"
    assert store.roles() == Roles(PACKAGED, None, "1.0")


def test_scores_of_bundles_that_were_exchanged_meanwhile_decide_nothing(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store, automatic=True) as keeper:
        old = keeper.serving
        done(keeper, keeper.answer({"action": "activate"}))
        keeper.consider(old, rows(0.3, 0.2))
        settled(keeper)
        assert store.roles() == Roles("1.0", PACKAGED, on_probation=True)


def test_an_automatic_order_that_fails_is_not_repeated_at_each_tick(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store, automatic=True) as keeper:
        (store.folder / "1.0" / "arx.json").unlink()
        serving = keeper.serving
        for _ in range(3):
            keeper.consider(serving, rows(0.3, 0.2))
        for _ in range(200):
            if told := keeper.events_pending():
                break
            time.sleep(0.01)
        keeper.consider(serving, rows(0.3, 0.2))
        time.sleep(0.05)
        told += keeper.events_pending()
    assert [event.key for event in told] == ["bundle.failed"]


def listed(keeper: BundleKeeper) -> dict[str, Any]:
    """All bundles, once the thread has looked."""
    for _ in range(1000):
        found = keeper.answer({"do": "bundle", "action": "list"})
        if not found["looking"]:
            return found
        time.sleep(0.005)
    raise AssertionError("nobody looks")


def test_an_order_is_told_with_its_author(workshop: Workshop) -> None:
    with keeping(make_store(workshop, "1.0")) as keeper:
        asked = {"do": "bundle", "action": "activate", "by": "Ann (page)\n"}
        done(keeper, keeper.answer(asked))
        done(keeper, keeper.answer(asked))
        done_well, failed = keeper.events_pending()
    assert done_well.text.startswith("asked for, by Ann (page); 1.0 is active, on probation")
    assert failed.text.startswith("activate (asked for, by Ann (page)): no bundle runs in shadow")


def test_the_list_says_what_is_installed_and_where_a_roll_back_leads(workshop: Workshop) -> None:
    with keeping(make_store(workshop)) as keeper:
        assert keeper.answer({"action": "list"})["looking"]
        found = listed(keeper)
        [packaged] = found["bundles"]
        assert (packaged["version"], packaged["created_utc"]) == (PACKAGED, "2026-07-01T12:00:00Z")
        assert (packaged["models"], packaged["problem"]) == (("arx", "pbm"), "")
        assert packaged["effects"] == ()  # the workshop's twin adds none
        assert (found["active"], found["back_to"], found["undo"]) == (PACKAGED, None, None)
        install(keeper._store, workshop.archive("1.0"))
        settled(keeper)
        assert listed(keeper)["shadow"] == "1.0"
        done(keeper, keeper.answer({"action": "activate"}))
        found = listed(keeper)
    assert [bundle["version"] for bundle in found["bundles"]] == [PACKAGED, "1.0"]
    assert (found["active"], found["back_to"], found["shadow"]) == ("1.0", PACKAGED, None)


def test_a_damaged_bundle_is_listed_with_the_reason(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store) as keeper:
        (store.folder / "1.0" / "arx.json").write_text("{}")
        (store.folder / "roles.json").write_text("{")
        found = listed(keeper)
    assert "arx.json: has 2 bytes" in found["bundles"][1]["problem"]
    assert found["back_to"] is None


def test_who_saw_another_bundle_rolls_nothing_back(workshop: Workshop) -> None:
    store = make_store(workshop, "1.0")
    with keeping(store) as keeper:
        done(keeper, keeper.answer({"action": "activate"}))
        for action, version, reason in (
            ("rollback", "2.0", "bundle 2.0 is not active any more: 1.0 is"),
            ("reject", "1.0", "no bundle runs in shadow"),
            ("undo-adoption", None, "no adopted twin runs: bundle 1.0 is active, none beside it"),
        ):
            status = done(keeper, keeper.answer({"action": action, "version": version}))
            assert status["job_error"] == reason
        assert store.roles().active == "1.0"
        assert done(keeper, keeper.answer({"action": "rollback", "version": "1.0"}))["active"] == PACKAGED
