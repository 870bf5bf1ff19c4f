"""The attack's own eyes: each violation is seen in a made-up outcome, and none in a good one."""

from dataclasses import replace
from typing import Any

import pytest

from bench.attack.lives import AnsweredOrder, LifeRemains, Outcome
from bench.attack.plan import AttackPlan, Life, draw
from bench.attack.scenarios import violations
from tests.support.watched_clock import Look

OK = {"ok": True}


def look(time_s: float, *on: str) -> Look:
    return Look(time_s, 25.0, "heater_relay" in on, None, False, "fan" in on, False, 1.0, on)


def lived(begin_s: float = 0.0, end_s: float = 100.0, **changes: Any) -> LifeRemains:
    life = Life(end_s - begin_s, False, 5.0, None)
    good = LifeRemains(life, begin_s, end_s, (1, 2, 3), (1, 2, 3), (), 0, "")
    return replace(good, **changes)


def outcome(looks: dict[float, tuple[str, ...]] | None = None, **changes: Any) -> Outcome:
    """A daemon that lives for 100 s and heats; from 101 s on the board is alone."""
    on = {time_s / 2: ("heater_relay",) for time_s in range(200)} | {
        100 + time_s / 2: () for time_s in range(80)
    }
    plan = AttackPlan(1, "python", {}, {}, (), (), ())
    good = Outcome(plan, (), (), (lived(),))
    given = replace(good, **changes)
    return replace(
        given, looks=tuple(look(time_s, *pins) for time_s, pins in sorted((on | (looks or {})).items()))
    )


def stopped_at(time_s: float, *on: str, do: str = "emergency_stop", **request: Any) -> dict[str, Any]:
    """A stop at `time_s`, after which the pins in `on` are on."""
    looks = {t / 2: on for t in range(int(2 * time_s) + 2, 280)}
    return {"looks": looks, "orders": (AnsweredOrder(time_s, {"do": do, **request}, OK),)}


def test_a_good_outcome_has_no_violation() -> None:
    assert violations(outcome()) == []
    assert violations(outcome(**stopped_at(40.0))) == []


def test_heat_longer_than_a_lease_after_the_daemons_end_is_seen() -> None:
    assert violations(outcome({110.0: ("heater_relay",)})) == []
    (text,) = violations(outcome({112.0: ("heater_relay",)}))
    assert "the heater pin is on at 112.0 s" in text


def test_heat_longer_than_a_lease_after_a_cut_line_is_seen() -> None:
    cut = AttackPlan(1, "python", {}, {}, (), ({"name": "unplug", "start_s": 50.0, "duration_s": 20.0},), ())
    (text,) = violations(outcome(plan=cut))
    assert "on at 61.0 s, nothing heard since 50.0 s" in text
    deaf_host = AttackPlan(
        1,
        "python",
        {},
        {},
        (),
        ({"name": "mute", "start_s": 50.0, "duration_s": 20.0, "direction": "to_host"},),
        (),
    )
    assert violations(outcome(plan=deaf_host)) == []


@pytest.mark.parametrize("pin", ["heater_relay", "fan", "led", "valve"])
def test_any_pin_that_is_on_after_a_stop_is_seen(pin: str) -> None:
    assert [text for text in violations(outcome(**stopped_at(40.0, pin))) if "stopped at 40.0 s" in text]


def test_a_pin_after_the_release_is_none_of_the_stops_business() -> None:
    case = stopped_at(40.0)
    case["looks"] |= {t / 2: ("fan",) for t in range(140, 160)}
    assert violations(outcome(**case)) != []
    case["orders"] += (AnsweredOrder(70.0, {"do": "release_emergency_stop"}, OK),)
    assert violations(outcome(**case)) == []


def test_maintenance_holds_for_its_minutes_and_until_it_is_taken_back() -> None:
    case = stopped_at(10.0, do="maintenance", minutes=1.0)
    case["looks"][69.0] = ("fan",)
    assert violations(outcome(**case)) != []
    case["looks"] |= {69.0: (), 71.0: ("fan",)}
    assert violations(outcome(**case)) == []
    case["looks"][60.0] = ("fan",)
    case["orders"] += (AnsweredOrder(50.0, {"do": "maintenance", "minutes": 0.0}, OK),)
    assert violations(outcome(**case)) == []


def test_a_stop_that_was_refused_promises_nothing() -> None:
    refused = (AnsweredOrder(40.0, {"do": "emergency_stop"}, {"ok": False}),)
    assert violations(outcome(orders=refused)) == []


def test_a_stop_during_a_cut_line_counts_from_the_lines_return() -> None:
    cut = AttackPlan(1, "python", {}, {}, (), ({"name": "unplug", "start_s": 38.0, "duration_s": 10.0},), ())
    case = stopped_at(40.0) | {"plan": cut}
    case["looks"] |= {t / 2: ("fan",) for t in range(82, 110)}
    assert violations(outcome(**case)) == []
    case["looks"][63.0] = ("fan",)
    assert violations(outcome(**case)) != []


@pytest.mark.parametrize(
    ("stored", "gaps", "seqs", "says"),
    [
        ((1, 2, 4), (), (1, 2, 3, 4), "ticks 3 to 3 are neither"),
        ((1, 2), (), (1, 2, 3), "ticks 3 to 3 are neither stored nor reported missing at the end"),
        ((1, 2, 3), ((3, 5),), (1, 2, 3), "tick 3 is in the history and reported missing"),
        ((1, 1_764_000_000), ((2, 1_763_999_999),), (1,), "more than can have been"),
    ],
)
def test_numbers_that_do_not_add_up_are_seen(stored: Any, gaps: Any, seqs: Any, says: str) -> None:
    assert any(
        says in text for text in violations(outcome(lives=(lived(stored=stored, gaps=gaps, seqs=seqs),)))
    )


def test_a_number_that_is_given_out_again_is_seen() -> None:
    first = lived(end_s=50.0, seqs=(1, 2, 3))
    second = lived(begin_s=55.0, seqs=(3, 4), stored=(1, 2, 3, 4))
    case = outcome({time_s / 2: () for time_s in range(100, 110)}, lives=(first, second))
    assert violations(case) == ["life 1 gives out the number 3 again, 3 was the last"]


def test_a_daemon_that_ends_by_itself_or_prints_a_traceback_is_seen() -> None:
    assert violations(outcome(lives=(lived(exit_code=1, output="Boom"),))) == [
        "life 0 ended with 1, not 0: Boom"
    ]
    assert violations(outcome(lives=(lived(output="Traceback (most\nError: x"),))) != []


def test_a_plan_is_the_same_at_every_draw_and_ends_in_good_order() -> None:
    assert draw(7) == draw(7)
    assert draw(7) != draw(8)
    for seed in range(40):
        last = draw(seed).lives[-1]
        assert not last.killed
        assert last.file_max is None
