"""A short form of `python -m bench.attack`: a few cases of each part, none of which may be violated."""

import os
from pathlib import Path

import pytest

from bench import kills
from bench.attack import answers, files, floods, links, payloads, scenarios
from bench.attack.part import Part, TrialResult
from bench.attack.plan import draw
from bench.kills import PINS, KillPlan, one_kill, rig_in, run
from tests.support.broker import needs_mosquitto, wait_for

PATIENT_S = 10.0  # for a stop where tests run beside it: the bench asks for 1 s
AT_ONCE = KillPlan("emergency_stop", "socket", 30.0, 0.0, 0.0, 20.0, False, None)


def violations(part: Part, seed: int, count: int) -> list[str]:
    found: list[TrialResult] = list(part(seed, count))
    assert found
    return [f"{each.name}: {text}" for each in found for text in each.violations]


def test_random_faults_kills_and_full_disks_break_no_invariant() -> None:
    seeds = (20, 25)  # the C board, killed twice; a disk that is full, a kill, and faults of line and rig
    cores = {plan.core for plan in map(draw, seeds)}
    lives = [life for plan in map(draw, seeds) for life in plan.lives]
    assert cores == {"c", "python"}
    assert any(life.killed for life in lives)
    assert any(life.file_max for life in lives)
    assert [text for each in map(scenarios.one, seeds) for text in each.violations] == []


def test_evil_answers_of_a_language_model_break_nothing() -> None:
    assert violations(answers.run, 11, 9) == []


def test_hostile_files_are_refused_in_a_few_lines_that_name_them() -> None:
    assert violations(files.run, 11, 30) == []


@needs_mosquitto
def test_hostile_payloads_from_the_broker_break_nothing() -> None:
    assert violations(payloads.run, 11, 60) == []


@needs_mosquitto
def test_a_flood_at_any_door_does_not_keep_a_stop_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floods, "OBEYED_S", PATIENT_S)
    monkeypatch.setattr(floods, "WARM_UP_S", 0.3)
    names = ("socket: never read", "mqtt: 10 000 at once", "page: half bodies")
    some = {name: floods.FLOODS[name] for name in names}
    monkeypatch.setattr(floods, "FLOODS", some)
    assert violations(floods.run, 11, len(some) * len(floods.WORDS)) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be led astray")
def test_root_is_led_nowhere_by_planted_links() -> None:
    assert violations(links.run, 11, 12) == []


@needs_mosquitto
def test_no_actuator_moves_after_an_acknowledged_stop_and_a_kill():
    assert run(3, seed=4, core="python") == 0


def test_a_stop_that_is_lost_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "MOSQUITTO", None)
    with rig_in(tmp_path, "python") as rig:
        rig.restart()
        rig.order("socket", kills.MOVING)
        wait_for(lambda: not kills._resting(rig, 0.0))
        kill = rig.kill

        def kill_and_forget() -> None:
            kill()
            (tmp_path / "state.json").write_text(standing)

        standing = (tmp_path / "state.json").read_text()
        rig.kill = kill_and_forget  # type: ignore[method-assign]
        found = " ".join(one_kill(rig, AT_ONCE))
    assert all(f"{pin} on" in found for pin in PINS if pin != "valve")
    assert "does not know" in found
