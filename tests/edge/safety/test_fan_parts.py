"""The fan for a part of a step: whole 5 s, the relay's shortest times, its switches per hour."""

from dataclasses import replace

import pytest
from safety_cases import NOW, echo, judge, reading, rules, view

from edge.config.settings import SafetySettings
from edge.core.messages import Command
from edge.safety.memory import SafetyMemory
from edge.safety.supervisor import planning_limits, supervise
from edge.safety.thermal_supervision import Observation, ThermalMemory, look

LIMITS = SafetySettings()


def fan(share: float) -> Command:
    return Command(fan_on=share > 0.0, fan_share=share or 1.0)


@pytest.mark.parametrize(
    ("asked_s", "sent_s"),
    [(0.0, 0.0), (4.9, 0.0), (5.0, 5.0), (9.9, 5.0), (30.0, 30.0), (59.9, 55.0), (60.0, 60.0)],
)
def test_a_part_is_cut_to_whole_5_s(asked_s, sent_s):
    sent = judge(fan(asked_s / 60.0)).sent
    assert sent.fan * 60.0 == pytest.approx(sent_s)
    assert sent.fan_on == (sent_s > 0.0)


def test_a_cut_part_has_its_reason():
    assert rules(judge(fan(0.2)), "fan_on") == ["fan.step"]  # 12 s are cut to 10
    assert rules(judge(fan(0.25)), "fan_on") == []


def test_a_part_shorter_than_the_relays_minimum_is_none():
    limits = replace(LIMITS, fan_min_on_s=20.0)
    assert supervise(fan(0.25), view(), SafetyMemory(), limits).sent.fan == 0.0
    assert supervise(fan(1.0 / 3.0), view(), SafetyMemory(), limits).sent.fan == pytest.approx(1.0 / 3.0)


def follow(shares, limits=LIMITS):
    """The shares that are sent, a minute apart."""
    memory, sent = SafetyMemory(), []
    for step, share in enumerate(shares):
        now_s = NOW + 60.0 * step
        air = replace(reading("temp_air", 25.0), time_s=now_s)
        seen = view(air=air, now_s=now_s)
        verdict = supervise(fan(share), seen, memory, limits)
        memory = verdict.memory
        sent.append(verdict.sent.fan)
    return sent, memory


def test_each_part_is_two_switches_and_a_whole_step_after_another_none():
    _, memory = follow([0.5, 0.5, 1.0, 1.0, 0.25, 0.0])
    # on, off, on, off, on, then off in the fifth step
    assert len(memory.fan_switches) == 6


def test_switches_are_bounded_and_the_last_one_leaves_the_fan_off():
    limits = replace(LIMITS, fan_switches_hour_max=8)
    sent, memory = follow([0.5] * 10, limits)
    assert [share > 0.0 for share in sent] == [True] * 4 + [False] * 6
    assert planning_limits(memory, limits, NOW + 540.0, 60.0).fan_starts == 0
    assert planning_limits(memory, limits, NOW + 3600.0 + 40.0, 60.0).fan_starts == 1


def test_a_fan_that_is_on_may_always_be_turned_off():
    limits = replace(LIMITS, fan_switches_hour_max=2)
    sent, _ = follow([1.0, 1.0, 0.0, 1.0], limits)
    assert sent == [1.0, 1.0, 0.0, 0.0]


def test_the_fan_that_safety_needs_is_not_counted_out():
    limits = replace(LIMITS, fan_switches_hour_max=2)
    memory = SafetyMemory(fan_switches=(NOW - 60.0, NOW - 30.0))
    hot = supervise(Command(), view(air=LIMITS.temp_air_max_c), memory, limits)
    assert hot.sent.fan == 1.0


def test_after_a_part_the_relay_rests_for_its_minimum():
    limits = replace(LIMITS, fan_min_off_s=120.0)
    sent, _ = follow([0.5, 0.5, 0.5, 0.5], limits)
    assert [share > 0.0 for share in sent] == [True, False, False, True]


def test_a_part_takes_no_known_heat_and_judges_no_fan():
    hot = Observation(60.0, 40.0, 20.0, 0.0, fan_on=True, led=0.0, fan_share=0.25)
    memory = ThermalMemory()
    for _ in range(60):
        memory, findings = look(memory, hot)
        assert "fan_no_effect" not in {finding.trip for finding in findings}
    assert memory.proof.fanned_s == pytest.approx(0.25 * 3600.0)


@pytest.mark.parametrize(("min_on_s", "part_s"), [(0.0, 5.0), (5.0, 5.0), (20.0, 20.0)])
def test_a_planner_knows_the_shortest_part(min_on_s, part_s):
    limits = replace(LIMITS, fan_min_on_s=min_on_s)
    assert planning_limits(SafetyMemory(), limits, NOW, 60.0).fan_part_s == part_s


def test_what_is_neither_on_nor_off_is_on_for_its_share_and_no_longer_than_the_step():
    assert rules(judge(Command(fan_on=2.0)), "fan_on") == ["fan.range"]
    assert judge(Command(fan_on=0.5)).sent == fan(0.5)


@pytest.mark.parametrize(("sent", "fanned_s"), [(fan(0.25), 15.0), (fan(1.0), 60.0), (Command(), 60.0)])
def test_supervision_counts_the_fan_for_its_time_and_one_that_nobody_ordered_in_full(sent, fanned_s):
    memory = SafetyMemory(sent=sent, time_s=NOW - 60.0)
    verdict = supervise(Command(), view(echo=echo(fan=True)), memory, LIMITS)
    assert verdict.memory.thermal.proof.fanned_s == pytest.approx(fanned_s)


def starts(memory, most=8):
    return planning_limits(memory, replace(LIMITS, fan_switches_hour_max=most), NOW, 60.0).fan_starts


def test_a_fan_that_is_on_has_its_end_in_hand():
    assert starts(SafetyMemory(sent=fan(1.0), fan_switches=(NOW - 60.0,))) == 3
    assert starts(SafetyMemory(sent=fan(0.5), fan_switches=(NOW - 60.0, NOW - 30.0))) == 3


def test_switches_count_for_an_hour():
    assert starts(SafetyMemory(fan_switches=(NOW - 3600.0, NOW - 3600.0)), most=2) == 1
    assert starts(SafetyMemory(fan_switches=(NOW - 3599.9, NOW - 3599.9)), most=2) == 0
    assert starts(SafetyMemory(fan_switches=(NOW - 1.0,) * 9), most=2) == 0
    kept = supervise(Command(), view(), SafetyMemory(fan_switches=(NOW - 3600.0, NOW - 10.0)), LIMITS)
    assert kept.memory.fan_switches == (NOW - 10.0,)
